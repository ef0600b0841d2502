"""The page of results: the answer, the digits on every track, all metrics, the error over time, and the player."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from dataclasses import replace

from ptne_env._version import __version__
from ptne_env.bench.report.page import Page, Part
from ptne_env.bench.report.tables import answer, answer_table, leaderboard_table, ordered, regret_table, track_tables
from ptne_env.bench.report.traces import Scene, scene
from ptne_env.bench.suite import LAW
from ptne_env.bench.workers import Workers
from ptne_env.evaluation.entries import POLICIES, PolicySpec
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.results import Results
from ptne_env.evaluation.tracks import Track
from ptne_env.world.catalogue import DESCRIPTIONS

SHOWN = 3
"""Policies that the figures of a track show: the paper's law, the user's own, then the best."""

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
        ImportError: when Jinja or Plotly is missing, naming the extra to install.
    """
    order, found = ordered(results), {}
    for index, made in workers.run(_scene, [_task(results, track, order) for track in results.tracks]):
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
        title=f"{results.name}, seed {results.seed}",
        question=_QUESTION,
        answer=answer(results),
        parts=(
            Part(
                "Results",
                "Digits are −log10 of the relative distance of all players' estimates from the equilibrium, counted up "
                "to 12. The mean regret is what the way there costs the players. A click on a heading sorts.",
                (answer_table(results), regret_table(results), *([] if board is None else [board])),
            ),
            Part(
                "Episode player",
                "Every step of the first episode, the same for every policy. Players have the numbers of their agents: "
                "0 is player_0.",
                has_player=True,
            ),
            Part("Tracks", "Every metric, and the error over time. Brackets are 95 % intervals."),
            *(_part(results, track, scenes[track.name]) for track in results.tracks),
            Part("Reproduce", facts=tuple((name, value) for name, value in facts.items() if value)),
        ),
        scenes=scenes,
    ).html()


def _task(results: Results, track: Track, order: Sequence[str]) -> tuple[Track, EpisodeSet, list[PolicySpec]]:
    """The arguments of :func:`_scene`: the policies of ``order`` that act on a track, those that are shown."""
    names = [name for name in order if (track.name, name) in results.samples]
    names.sort(key=lambda name: (name != LAW, name in POLICIES))
    whole = results.episode_sets[track.name]
    return track, replace(whole, count=min(EPISODES, whole.count)), [results.policies[name] for name in names[:SHOWN]]


def _scene(track: Track, episodes: EpisodeSet, policies: Sequence[PolicySpec]) -> Scene:
    return scene(track.world, episodes, policies, None if track.teammates is None else track.teammates.join)


def _part(results: Results, track: Track, found: Scene) -> Part:
    scenario, game = track.scenario, track.world.game
    about = DESCRIPTIONS.get(track.name, "") if results.is_comparison else track.change
    median = f"median and 10–90 % band over {found.episodes} episodes" if found.episodes > 1 else "one episode"
    return Part(
        track.name,
        f"{about} {type(game).__name__} with {game.num_players} players; T = {scenario.deadline:g} s, "
        f"c = {scenario.gain:g} per second, {scenario.steps} steps to the deadline, {scenario.hold_steps} after it.",
        tuple(track_tables(results, track)),
        scene=found,
        caption=f"Relative error of all players' estimates over time; the deadline is dotted; {median}.",
        is_folded=True,
    )
