"""How did it get there? Error against time over a few episodes, and one episode to look at, instant by instant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ptne_env import dynamics
from ptne_env.arrays import BoolArray, FloatArray, IntArray, require_count
from ptne_env.dynamics import State
from ptne_env.encoder import make_encoder
from ptne_env.experiments.benchmark import Run
from ptne_env.experiments.compare import Results
from ptne_env.experiments.episodes import Split, draw_start
from ptne_env.experiments.policy_specs import PolicySpec
from ptne_env.experiments.rollout import Member, rollout
from ptne_env.experiments.suite import Suite, Track
from ptne_env.experiments.workers import Workers
from ptne_env.scenario import Scenario
from ptne_env.world import World

EPISODES = 20
"""Episodes over which errors are told, where nothing else is said."""

FRAMES = 60
"""About as many instants of an episode are kept, where nothing else is said."""

QUANTILES = (0.1, 0.5, 0.9)
"""Of the error over episodes: the band and the median."""


@dataclass(frozen=True)
class Trace:
    """One policy in one world. F instants are kept; the first episode is kept whole.

    Attributes:
        errors: :data:`QUANTILES` over episodes of the estimate distance, shape (3, F).
        error: the estimate distance of the first episode, shape (F,).
        estimates: x^i in column i, shape (n, N, F).
        inputs: the inputs of the strategies, own block by own block, held from each instant; NaN at the last. (n, F).
        consensus_gains: what multiplies Σ_j a_ij (x^j − x^i) in the inputs of the others' blocks of x^i, by least
            squares; NaN where a player hears nothing that differs from its own estimate. Shape (N, F).
    """

    errors: FloatArray
    error: FloatArray
    estimates: FloatArray
    inputs: FloatArray
    consensus_gains: FloatArray


@dataclass(frozen=True)
class Scene:
    """A world, its first episode, and how every policy did there.

    Attributes:
        t: seconds at each instant that is kept, shape (F,).
        s: transformed time, shape (F,); it ends at the deadline.
        gain: g(t) in 1/s, shape (F,).
        deadline_frame: index of the instant T.
        owners: the player who owns each component, shape (n,).
        equilibrium: x* of the first episode, shape (n,).
        links: pairs of players who are ever neighbours, shape (L, 2).
        live: whether each link is up in the first episode, shape (L, F).
        episodes: over which errors are told.
        traces: by name of the policy.
    """

    t: FloatArray
    s: FloatArray
    gain: FloatArray
    deadline_frame: int
    owners: IntArray
    equilibrium: FloatArray
    links: IntArray
    live: BoolArray
    episodes: int
    traces: dict[str, Trace]

    @property
    def num_players(self) -> int:
        """N."""
        return int(self.owners[-1]) + 1


def comparison_scenes(
    results: Results,
    *,
    episodes: int = EPISODES,
    workers: Workers = Workers(),  # noqa: B008 - immutable
    progress: Callable[[str], None] | None = None,
) -> dict[str, Scene]:
    """A scene per scenario of a comparison on the split ``test``, from the first ``episodes`` of its starts.

    Args:
        results: of the comparison.
        episodes: at most as many as the comparison had.
        workers: who runs the episodes.
        progress: called with the name of the scenario when it is done.
    """
    require_count("episodes", episodes, 1)
    tasks = {}
    for label, scenario in results.scenarios.items():
        cells = [cell for cell in results.cells if cell.scenario == label]
        entries = results.entries | {entry.name: entry for entry in results.tuned.get(label, {}).values()}
        count = min(episodes, len(cells[0].samples["digits"]))
        tasks[label] = (scenario, count, results.seed, {cell.policy: entries[cell.policy] for cell in cells})
    return _scenes(_comparison_scene, tasks, workers, progress)


def _comparison_scene(scenario: Scenario, episodes: int, seed: int, entries: Mapping[str, PolicySpec]) -> Scene:
    world = World(scenario)
    return scene(world, draw_start(world, episodes, seed), entries)


def suite_scenes(
    run: Run,
    *,
    episodes: int = EPISODES,
    workers: Workers = Workers(),  # noqa: B008 - immutable
    progress: Callable[[str], None] | None = None,
) -> dict[str, Scene]:
    """A scene per track of a suite, from the first ``episodes`` of the bank; of a learned policy, its first seed.

    Args:
        run: of the suite.
        episodes: at most as many as the run had.
        workers: who runs the episodes.
        progress: called with the name of the track when it is done.
    """
    count = min(require_count("episodes", episodes, 1), run.episodes)
    tasks = {}
    for track in run.tracks:
        entries = {
            name: participant.runs[0]
            for name, participant in run.participants.items()
            if run.of(track.name, name)[0].reason is None
        }
        tasks[track.name] = (run.suite, track, count, run.seed, run.split, entries)
    return _scenes(_suite_scene, tasks, workers, progress)


def _suite_scene(
    suite: Suite, track: Track, episodes: int, seed: int, split: Split, entries: Mapping[str, PolicySpec]
) -> Scene:
    world = World(track.scenario)
    start = suite.draw_start(world, track.name, episodes, seed=seed, split=split)
    return scene(world, start, entries, None if track.teammates is None else track.teammates.join)


def _scenes(
    function: Callable[..., Scene],
    tasks: Mapping[str, tuple[Any, ...]],
    workers: Workers,
    progress: Callable[[str], None] | None,
) -> dict[str, Scene]:
    names = list(tasks)

    def tell(index: int, _: Scene) -> None:
        if progress is not None:
            progress(names[index])

    return dict(zip(names, workers.gather(function, list(tasks.values()), tell), strict=True))


def scene(
    world: World,
    start: State,
    entries: Mapping[str, PolicySpec],
    teammates: Callable[[World], Member] | None = None,
    *,
    frames: int = FRAMES,
) -> Scene:
    """How each of several policies does from the same start.

    Args:
        world: the world.
        start: of all episodes.
        entries: the policies by name.
        teammates: make those who act beside each of them.
        frames: about as many instants are kept.

    Raises:
        ValueError: when a policy cannot act in this world.
    """
    clock = world.clock
    share = clock.steps / clock.total_steps
    kept = np.unique(
        np.concatenate(
            [
                np.linspace(0, clock.steps, 1 + max(1, round(frames * share))).round(),
                np.linspace(clock.steps, clock.total_steps, 1 + round(frames * (1 - share))).round(),
            ]
        )
    ).astype(np.int64)
    links = np.array(world.topology.union.edges, dtype=np.int64).reshape(-1, 2)
    traces = {}
    for name, entry in entries.items():
        encoder = make_encoder(world, entry.interface)
        watch = _Watch(world, kept)
        outcome = rollout(
            entry.build(encoder.layout), encoder, start, None if teammates is None else teammates(world), watch
        )
        errors = np.quantile(outcome.estimate_distance[kept], QUANTILES, axis=1)
        traces[name] = Trace(errors, outcome.estimate_distance[kept, 0], *watch.arrays())
    t, deadline = clock.t[kept], int(np.searchsorted(kept, clock.steps))
    randomness = start.randomness
    modes = world.modes[kept] if randomness is None or randomness.modes is None else randomness.modes[kept, 0]
    live = np.array([world.topology.graphs[mode].adjacency[links[:, 0], links[:, 1]] > 0 for mode in modes])
    return Scene(
        t=t,
        s=clock.s[kept],
        gain=clock.transformation.gain(t, clock.gain),
        deadline_frame=deadline,
        owners=world.game.owners,
        equilibrium=start.game.nash_equilibria[:, 0],
        links=links,
        live=live.T,
        episodes=dynamics.batch_size(start),
        traces=traces,
    )


class _Watch:
    """Keeps some instants of the first episode of a rollout."""

    def __init__(self, world: World, frames: IntArray) -> None:
        self._world = world
        self._owners = world.game.owners
        self._frames = frozenset(frames.tolist())
        self._estimates: list[FloatArray] = []
        self._inputs: list[FloatArray] = []
        self._gains: list[FloatArray] = []

    def __call__(self, state: State, inputs: FloatArray | None) -> None:
        if int(state.step[0]) not in self._frames:
            return
        self._estimates.append(state.estimates[:, :, 0].copy())
        components, players = np.arange(len(self._owners)), np.arange(state.estimates.shape[1])
        if inputs is None:
            self._inputs.append(np.full(len(components), np.nan))
            self._gains.append(np.full(len(players), np.nan))
            return
        first = inputs[:, :, 0]
        self._inputs.append(first[components, self._owners])
        received = (
            dynamics.weights(self._world, state)[:, None, :, 0]
            * dynamics.relative_estimates(self._world, state)[..., 0]
        ).sum(axis=0)
        received[components, self._owners] = 0  # the gradient acts in one's own block
        squares = (received**2).sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            self._gains.append(np.where(squares > 0, (received * first).sum(axis=0) / squares, np.nan))

    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Estimates, inputs and gains, instants last."""
        return tuple(np.stack(kept, axis=-1) for kept in (self._estimates, self._inputs, self._gains))  # type: ignore[return-value]
