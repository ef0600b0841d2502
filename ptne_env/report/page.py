"""Pages that open without a network, from one template: text, tables, charts and the player of an episode.

:func:`results_page` is the page of a comparison or of another suite, :func:`episode_page` the player of one episode.
"""

from __future__ import annotations

import math
import platform
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain, cycle

from ptne_env._version import __version__
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.metrics import MOST_DIGITS
from ptne_env.evaluation.policy_spec import PolicySpec
from ptne_env.evaluation.results import Results
from ptne_env.evaluation.statistics import Summary
from ptne_env.evaluation.tracks import Track
from ptne_env.execution.workers import Workers
from ptne_env.report.tables import (
    Table,
    answer,
    answer_table,
    join_words,
    leaders,
    means_over_tracks,
    order_policies,
    place_noun,
    track_tables,
)
from ptne_env.report.traces import Scene, make_scene
from ptne_env.shared.style import COLOURS, DARK, LIGHT
from ptne_env.world.catalogue import DESCRIPTIONS
from ptne_env.world.scenario import Scenario

EPISODES, MANY = 10, 20
"""Largest number of episodes behind the errors over time; and of players above which it is one, which takes as long."""


@dataclass(frozen=True)
class DotPlot:
    """The digits of a few policies, a row per track, which the style sheet of the page draws without a script.

    ``kinds`` says what each policy is. A policy without a value on a track has no dot there.
    """

    kinds: Mapping[str, str]
    rows: Mapping[str, Mapping[str, Summary]]

    @property
    def ticks(self) -> list[int]:
        """Whole numbers of digits from below the least value, and 0, to above the largest."""
        ends = [end for row in self.rows.values() for digits in row.values() for end in vars(digits).values()]
        low, high = math.floor(min([0.0, *filter(None, ends)])), math.ceil(max([1.0, *filter(None, ends)]))
        return list(range(low, min(round(MOST_DIGITS), high) + 1))  # longer intervals are cut there

    def place(self, value: float) -> str:
        """Return the place of a value in percent of the width."""
        first, last = self.ticks[0], self.ticks[-1]
        return f"{100 * (min(value, last) - first) / (last - first):.2f}"


@dataclass(frozen=True)
class Section:
    """A section of a page: a paragraph, tables, a chart of the errors of a scene by name, names and values, the player.

    Where ``is_folded``, a click on the heading shows them.
    """

    title: str
    text: str = ""
    tables: tuple[Table, ...] = ()
    scene: str = ""
    caption: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)
    has_player: bool = False
    is_folded: bool = False


@dataclass(frozen=True)
class Page:
    """The content of a page: sections, the answer in sentences and as a picture, and scenes for the player by name.

    ``noun`` is the word for a scene.
    """

    title: str
    sections: tuple[Section, ...]
    noun: str = "scenario"
    answer: tuple[str, ...] = ()
    dots: DotPlot | None = None
    scenes: Mapping[str, Scene] = field(default_factory=dict)

    def to_html(self) -> str:
        """Return one HTML file with everything that it needs inside."""
        try:
            from jinja2 import Environment, PackageLoader, StrictUndefined
        except ImportError as error:
            raise ImportError('pages need Jinja: pip install "ptne-env[bench]"') from error

        names = [*(self.dots.kinds if self.dots else ()), *chain(*(scene.policies for scene in self.scenes.values()))]
        environment = Environment(
            autoescape=True,  # users choose the names of policies
            loader=PackageLoader("ptne_env.report"),
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        html = environment.get_template("page.html").render(
            page=self,
            packed={f"scene-{index}": scene.packed for index, scene in enumerate(self.scenes.values())},
            light=LIGHT,
            dark=DARK,
            colours=COLOURS,
            policies=dict(zip(dict.fromkeys(names), cycle(COLOURS), strict=False)),
        )
        return re.sub(r"\n\s+", "\n", html)  # the indentation of the template is a tenth of the page


def results_page(
    results: Results,
    command: str = "",
    workers: Workers = Workers(),  # noqa: B008 - immutable
    progress: Callable[[str, int, int], None] | None = None,
) -> str:
    """Return results as one HTML file with everything that it needs inside.

    Args:
        results: the results of a comparison or of another suite.
        command: the command that repeats the results; empty where none does.
        workers: the workers that run the episodes of the figures.
        progress: called with the name of a track, the number of finished tracks, and the number of tracks.

    Raises:
        ImportError: when Jinja is missing, naming the extra to install.
    """
    drawn: dict[str, Scene] = {}
    longest_first = sorted(results.tracks, key=lambda track: track.world.neighbours.size, reverse=True)
    for index, scene in workers.run(make_scene, [_scene_arguments(results, track) for track in longest_first]):
        drawn[longest_first[index].name] = scene
        if progress is not None:
            progress(longest_first[index].name, len(drawn), len(results.tracks))
    scenes = {track.name: drawn[track.name] for track in results.tracks}
    noun = place_noun(results)
    names = [track.name for track in results.tracks]
    where = join_words(names, most=3)
    if not results.is_comparison:
        where = f"{len(names)} tracks of {results.name}" if len(names) > 2 else f"{where} of {results.name}"
    return Page(
        title=f"{join_words(order_policies(results), most=3)} on {where}",
        answer=answer(results),
        dots=_dot_plot(results),
        noun=noun,
        sections=(
            Section(
                "Results",
                "Digits are −log10 of the relative distance of all players' estimates from the equilibrium, counted up "
                "to 12. Digits on the way are the mean after every step. Click a heading to sort by it; a "
                "shadow at an edge shows that the table continues there.",
                (answer_table(results),),
            ),
            Section(
                "Episode player",
                "Every step of the first episode, which is the same for every policy. It and all figures show the "
                "policies of the figure above: the paper's law, the best law, the best learned policy and the best "
                "of yours. Players have the numbers of their agents: 0 is player_0.",
                has_player=True,
            ),
            Section(f"{noun.capitalize()}s", "Every metric, and the error over time. Brackets are 95 % intervals."),
            *(_track_section(results, track, scenes[track.name].episodes) for track in results.tracks),
            _origin(command, results.seed, results.split, suite=results.name),
        ),
        scenes=scenes,
    ).to_html()


def episode_page(scenario: Scenario, spec: PolicySpec, *, seed: int = 0, command: str = "") -> str:
    """Return the player of the first episode of the test split as one HTML file, with the command that repeats it.

    Raises:
        ValueError: when the policy cannot act in the scenario.
        ImportError: when Jinja is missing, naming the extra to install.
    """
    scenes = {scenario.name: make_scene(Track(scenario.name, scenario, ""), EpisodeSet(1, seed), [spec])}
    player = Section("Episode player", has_player=True)
    return Page(f"{scenario.name}: {spec.name}", (player, _origin(command, seed, "test")), scenes=scenes).to_html()


def _origin(command: str, seed: int, split: str, **names: str) -> Section:
    """Return the section that says how to repeat what a page shows; an empty command repeats nothing."""
    facts = {"command": command} if command else {}
    facts |= {**names, "seed": str(seed), "split": split}
    return Section("Reproduce", facts=facts | {"ptne_env": __version__, "Python": platform.python_version()})


def _scene_arguments(results: Results, track: Track) -> tuple[Track, EpisodeSet, list[PolicySpec]]:
    """Return the arguments of :func:`make_scene`: the leaders that act on the track, or else the best that acts."""
    acting = [name for name in order_policies(results) if (track.name, name) in results.samples]
    names = [name for name in leaders(results) if name in acting] or acting[:1]
    whole = results.episode_sets[track.name]
    count = 1 if track.world.game.num_players > MANY else min(EPISODES, whole.count)
    return track, replace(whole, count=count), [results.policies[name] for name in names]


def _track_section(results: Results, track: Track, episodes: int) -> Section:
    scenario, game = track.scenario, track.world.game
    about = DESCRIPTIONS.get(track.name, track.change) if results.is_comparison else track.change
    until = "the end; the deadline is dotted" if scenario.hold_steps else "the deadline"
    median = f"median and 10–90 % band over {episodes} episodes" if episodes > 1 else "one episode"
    return Section(
        track.name,
        f"{about} {type(game).__name__} with {game.num_players} players; T = {scenario.deadline:g} s, "
        f"c = {scenario.gain:g} per second, {scenario.steps} steps to the deadline, {scenario.hold_steps} after it.",
        tuple(track_tables(results, track)),
        scene=track.name,
        caption=f"Relative error of all players' estimates until {until}; {median}.",
        is_folded=True,
    )


def _dot_plot(results: Results) -> DotPlot:
    """Return the digits of the leaders on every track, and their means where there are several tracks."""
    kinds, means = leaders(results), means_over_tracks(results)
    rows = {
        track.name: {name: results.summary(track.name, name, "digits") for name in kinds} for track in results.tracks
    }
    if len(rows) > 1:
        rows["mean" if results.is_comparison else "score"] = {name: means[name][0] for name in kinds if name in means}
    return DotPlot(
        kinds,
        {
            row: {name: digits for name, digits in cells.items() if digits and digits.mean is not None}
            for row, cells in rows.items()
        },
    )
