"""The page of results: the answer, the digits on every track, all metrics, the error over time, and the player."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from dataclasses import replace

from ptne_env._version import __version__
from ptne_env.evaluation.entries import PolicySpec
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.results import Results
from ptne_env.evaluation.tracks import Track
from ptne_env.execution.workers import Workers
from ptne_env.report.dots import dot_plot
from ptne_env.report.page import Page, Part
from ptne_env.report.tables import (
    answer,
    answer_table,
    leaderboard_table,
    leaders,
    ordered,
    regret_table,
    track_tables,
)
from ptne_env.report.traces import Scene, scene
from ptne_env.world.catalogue import DESCRIPTIONS

EPISODES = 20
"""Episodes behind the errors over time; tracks with fewer have them all."""

_QUESTION = (
    "Which policy brings the estimates of all players closest to the Nash equilibrium by the deadline, using only "
    "information that players have, and does it beat the paper's law?"
)


def page(
    results: Results,
    command: str = "",
    workers: Workers = Workers(),  # noqa: B008 - immutable
    progress: Callable[[str, int, int], None] | None = None,
) -> str:
    """Results as one HTML file with everything that it needs inside.

    Args:
        results: of a comparison or of another suite.
        command: that repeats the results; empty where none does.
        workers: run the episodes of the figures.
        progress: called with the name of a track, and the numbers of finished tracks and of all.

    Raises:
        ImportError: when Jinja is missing, naming the extra to install.
    """
    found = {}
    for index, made in workers.run(_scene, [_task(results, track) for track in results.tracks]):
        found[index] = made
        if progress is not None:
            progress(results.tracks[index].name, len(found), len(results.tracks))
    scenes = {track.name: found[index] for index, track in enumerate(results.tracks)}
    board = leaderboard_table(results)
    facts = {
        "command": command,
        "suite": results.name,
        "seed": str(results.seed),
        "split": results.split,
        "ptne_env": __version__,
        "Python": platform.python_version(),
    }
    return Page(
        title=_title(results),
        question=_QUESTION,
        answer=answer(results),
        dots=dot_plot(results),
        parts=(
            Part(
                "Results",
                "Digits are −log10 of the relative distance of all players' estimates from the equilibrium, counted up "
                "to 12. The mean regret is what the way there costs the players. A click on a heading sorts; a shadow "
                "at an edge tells that a table goes on there.",
                (answer_table(results), regret_table(results), *([] if board is None else [board])),
            ),
            Part(
                "Episode player",
                "Every step of the first episode, the same for every policy. Players have the numbers of their agents: "
                "0 is player_0.",
                has_player=True,
            ),
            Part("Tracks", "Every metric, and the error over time. Brackets are 95 % intervals."),
            *(_part(results, track, scenes[track.name].episodes) for track in results.tracks),
            Part("Reproduce", facts=tuple((name, value) for name, value in facts.items() if value)),
        ),
        scenes=scenes,
    ).html()


def _title(results: Results) -> str:
    """What was compared, and on what."""
    tracks = [track.name for track in results.tracks]
    where = _few(tracks)
    if not results.is_comparison:
        where = f"{len(tracks)} tracks of {results.name}" if len(tracks) > 2 else f"{where} of {results.name}"
    return f"{_few(ordered(results))} on {where}"


def _few(names: Sequence[str], most: int = 3) -> str:
    """The first of some names, and how many more there are."""
    shown = [*names[:most], *([f"{len(names) - most} more"] if len(names) > most else [])]
    return " and ".join(filter(None, [", ".join(shown[:-1]), shown[-1]]))


def _task(results: Results, track: Track) -> tuple[Track, EpisodeSet, list[PolicySpec]]:
    """The arguments of :func:`_scene`: the leading policies that act on a track, or the best one where none does."""
    acting = [name for name in ordered(results) if (track.name, name) in results.samples]
    names = [name for name in leaders(results) if name in acting] or acting[:1]
    whole = results.episode_sets[track.name]
    return track, replace(whole, count=min(EPISODES, whole.count)), [results.policies[name] for name in names]


def _scene(track: Track, episodes: EpisodeSet, policies: Sequence[PolicySpec]) -> Scene:
    return scene(track.world, episodes, policies, None if track.teammates is None else track.teammates.join)


def _part(results: Results, track: Track, episodes: int) -> Part:
    scenario, game = track.scenario, track.world.game
    about = DESCRIPTIONS.get(track.name, "") if results.is_comparison else track.change
    until = "the end; the deadline is dotted" if scenario.hold_steps else "the deadline"
    median = f"median and 10–90 % band over {episodes} episodes" if episodes > 1 else "one episode"
    return Part(
        track.name,
        f"{about} {type(game).__name__} with {game.num_players} players; T = {scenario.deadline:g} s, "
        f"c = {scenario.gain:g} per second, {scenario.steps} steps to the deadline, {scenario.hold_steps} after it.",
        tuple(track_tables(results, track)),
        scene=track.name,
        caption=f"Relative error of all players' estimates until {until}; {median}.",
        is_folded=True,
    )
