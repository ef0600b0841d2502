"""Trajectories: every instant of the episodes of a policy, as arrays, a table, a file or a figure."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from json import dumps
from pathlib import Path
from typing import Any

import numpy as np

from ptne_env.evaluation.episodes import EpisodeSet, Split
from ptne_env.evaluation.policy_spec import PolicySpec, get_policy_spec
from ptne_env.evaluation.rollout import Rollout, rollout
from ptne_env.evaluation.tracks import Track, compared_tracks
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.observation import LayoutError
from ptne_env.perception.policy import Policy
from ptne_env.shared.arrays import FloatArray, IntArray, data_frame, require_count
from ptne_env.shared.files import require_suffix, write_atomically
from ptne_env.shared.style import COLOURS, INK, PRINT, drawing, encode, printed_axes
from ptne_env.world import distances, dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.scenario import Scenario

QUANTILES = (0.1, 0.5, 0.9)
"""The quantiles of the error over episodes: the ends of the band, and the median between them."""


@dataclass(frozen=True, eq=False, repr=False)
class Trajectories:
    """Episodes of a policy at their instants, from t = 0 to the end of the hold phase.

    Shapes have F instants first and B episodes last; between them are N players, n components of x and L directed
    links. The arrays are float64 and named by :data:`ARRAYS`.

    Attributes:
        policy: the name of the policy.
        episodes: the episodes; ``env.reset(seed=run.episodes.episode_seed(k))`` replays episode k.
        rollout: the series of the episodes, from which metrics follow.
        t: the time in seconds, shape (F,).
        s: the transformed time, which stays as it is after the deadline, shape (F,).
        tau: the effective time τ = Σ Θ, in which every step of a law counts by its length, shape (F,).
        strategies: x, shape (F, n, B).
        estimates: the players' estimates of x, row i being x^i, shape (F, N, n, B).
        inputs: the inputs that are held from each instant, row i being u^i; NaN at the last. Shape (F, N, n, B).
        links: the pairs (receiver, sender) of players that are ever neighbours, int64, shape (L, 2).
        weights: a_ij of the receiver; 0 where nothing arrives. Shape (F, L, B).
        messages: x^j as it arrived − x^i of the receiver, as the policy is shown it; 0 where nothing arrives. Shape
            (F, L, n, B).
        nash_equilibria: x*, shape (n, B).
        errors: the estimate distance ‖𝐱 − 1⊗x*‖/(√N ‖x*‖), whose −log10 at the deadline are the digits, shape (F, B).
        strategy_errors: the strategy distance ‖x − x*‖/‖x*‖, shape (F, B).
    """

    policy: str
    episodes: EpisodeSet
    rollout: Rollout
    t: FloatArray
    s: FloatArray
    tau: FloatArray
    strategies: FloatArray
    estimates: FloatArray
    inputs: FloatArray
    links: IntArray
    weights: FloatArray
    messages: FloatArray
    nash_equilibria: FloatArray
    errors: FloatArray
    strategy_errors: FloatArray

    def __repr__(self) -> str:
        scenario, (instants, episodes) = self.rollout.world.scenario.name, self.errors.shape
        return f"<Trajectories of {self.policy} on {scenario}: {instants} instants, {episodes} episodes>"

    def columns(self) -> dict[str, Any]:
        """Return the arrays as columns by name, with a row per episode and instant.

        An entry has the name of its array and its indices, such as ``estimates_1_0``, which is player 1's estimate of
        component 0. A link has the numbers of its receiver and its sender, so ``messages_1_2_0`` came from player 2.
        """
        instants, episodes = len(self.t), self.nash_equilibria.shape[-1]
        columns: dict[str, Any] = {"episode": np.repeat(np.arange(episodes), instants)}
        for name in ARRAYS:
            array = getattr(self, name)
            if name == "links":
                continue
            if name == "nash_equilibria":
                array = np.broadcast_to(array, (instants, *array.shape))
            if array.ndim == 1:
                array = np.broadcast_to(array[:, None], (instants, episodes))
            for index in np.ndindex(array.shape[1:-1]):
                link = self.links[index[0]] if name in ("weights", "messages") else index[:1]
                columns["_".join(map(str, (name, *link, *index[1:])))] = array[:, *index].T.ravel()
        return columns

    def to_frame(self) -> Any:
        """Return :meth:`columns` as a ``pandas.DataFrame``; ``ImportError`` that names the extra if it is missing."""
        return data_frame(self.columns())

    def save(self, path: str | Path) -> None:
        """Write a file, whose suffix is one of :data:`SUFFIXES`.

        Beside the arrays, ``.npz`` and ``.mat`` hold the texts ``policy``, its name, and ``scenario``, a JSON object.

        Raises:
            ValueError: for another suffix.
            ImportError: when matplotlib is missing, naming the extra to install.
            OSError: when the file cannot be written.
        """
        suffix, buffer = require_suffix("trajectories are", Path(path), SUFFIXES), io.BytesIO()
        arrays = {name: getattr(self, name) for name in ("policy", *ARRAYS)}
        arrays["scenario"] = dumps(self.rollout.world.scenario.to_dict(), ensure_ascii=False)
        if suffix == ".npz":
            np.savez_compressed(buffer, **arrays)
        elif suffix == ".mat":
            from scipy.io import savemat

            savemat(buffer, arrays, do_compression=True, oned_as="column")
        elif suffix == ".csv":
            columns = self.columns()
            rows = np.column_stack(list(columns.values()))
            np.savetxt(buffer, rows, "%.17g", ",", header=",".join(columns), comments="")
        else:
            buffer.write(encode(self.plot(), suffix[1:]))
        write_atomically(Path(path), buffer.getvalue())

    def plot(self, axes: Sequence[Any] | None = None, *, estimates: bool = False) -> Any:
        """Draw the strategies of the first episode, and the errors of all, over time.

        Dotted lines are the equilibrium, and the vertical line the deadline. Several episodes have the median of their
        errors, and the band from 10 to 90 %.

        Args:
            axes: the two axes to draw into; by default those of a new figure, one column wide and unknown to pyplot.
            estimates: whether thin lines are the estimates of the strategies by the other players.

        Returns:
            The figure of matplotlib; ``ImportError`` that names the extra if it is missing.
        """
        world = self.rollout.world
        with drawing("figures", PRINT):
            top, bottom = axes = printed_axes(2, 3.0) if axes is None else axes
            for component, owner in enumerate(world.game.owners):
                line: dict[str, Any] = {"color": COLOURS[owner % len(COLOURS)]}
                if estimates:
                    others = np.delete(self.estimates[:, :, component, 0], owner, axis=1)
                    top.plot(self.t, others, linewidth=0.5, alpha=0.6, **line)
                is_first = component == 0 or owner != world.game.owners[component - 1]
                label = f"{'' if owner else 'player '}{owner}" if is_first and world.game.num_players <= 10 else None
                top.plot(self.t, self.strategies[:, component, 0], label=label, **line)
                top.axhline(self.nash_equilibria[component, 0], linestyle=":", linewidth=0.9, **line)
            low, median, high = np.quantile(np.maximum(self.errors, distances.FLOOR), QUANTILES, axis=1)
            if self.errors.shape[1] > 1:
                bottom.fill_between(self.t, low, high, color=INK, alpha=0.2, linewidth=0)
            bottom.semilogy(self.t, median, color=INK)
            for each in axes:
                each.axvline(world.clock.deadline, color=INK, linewidth=0.8, linestyle="--", zorder=0, clip_on=False)
            at: Any = (world.clock.deadline, 1), (0, 2), ("data", "axes fraction"), "offset points"
            bottom.annotate("$T$", *at, ha="center", va="bottom")
            top.set(ylabel="strategies", xlim=(0, self.t[-1]))
            bottom.set(ylabel="relative error", xlabel="time t [s]", xlim=(0, self.t[-1]))
            bottom.locator_params(axis="y", numticks=6)
            if world.game.num_players <= 10:
                place: dict[str, Any] = {"loc": "lower center", "bbox_to_anchor": (0.5, 1), "borderaxespad": 0}
                top.legend(ncols=10, handlelength=0.9, handletextpad=0.4, columnspacing=0.9, **place)
            return top.figure


ARRAYS = tuple(field.name for field in fields(Trajectories))[3:]
"""The names of the arrays of trajectories."""

SUFFIXES: Mapping[str, str] = {
    ".npz": "the arrays by name, for numpy",
    ".mat": "the arrays by name, for MATLAB",
    ".csv": "a table with a row per instant",
    **dict.fromkeys((".pdf", ".svg", ".png"), "a figure"),
}
"""What is written to a file, by its suffix."""


def record(
    policy: str | Path | PolicySpec | Policy,
    scenario: str | Scenario | Track,
    *,
    seed: int = 0,
    episodes: int = 1,
    split: Split = "test",
    trust: bool = False,
) -> Trajectories:
    """Play the episodes that :func:`ptne_env.evaluate` plays, and return all that happens in them.

    Args:
        policy: the policy, as for :func:`ptne_env.evaluate`; of several training seeds the first.
        scenario: the scenario or track, as for :func:`ptne_env.evaluate`.
        seed: the seed of the episodes.
        episodes: the number of episodes; where nothing is random there is one.
        split: as for :func:`ptne_env.evaluate`.
        trust: likewise.

    Raises:
        ValueError, TypeError: as :func:`ptne_env.evaluate`.
        LayoutError: when the policy cannot act in the scenario.
        PolicyError: when the policy cannot be built, raises, or answers in another form.
    """
    require_count("episodes", episodes, 1)
    ((track, drawn),) = compared_tracks([scenario], episodes, seed, split).items()
    return play(track, get_policy_spec(policy, trust=trust), replace(drawn, count=min(drawn.count, episodes)))


def play(track: Track, spec: PolicySpec, episodes: EpisodeSet, kept: int | None = None) -> Trajectories:
    """Return the trajectories of the first ``kept`` episodes, or of all, with all errors; raises as :func:`record`."""
    spec, world = spec.on_scenario(track.scenario.name), track.world
    encoder = Encoder(world, spec.interface)
    start, clock, owners = episodes.initial_state(world), world.clock, world.game.owners
    receivers, slots = np.nonzero(np.arange(world.game.num_players)[:, None] != world.neighbours.T)
    senders, own = world.neighbours[slots, receivers], (owners, np.arange(len(owners)))
    instants: list[dict[str, FloatArray]] = []

    def watch(state: State, held: FloatArray | None) -> None:
        estimates = state.estimates[..., :kept].swapaxes(0, 1)
        weights = np.broadcast_to(dynamics.weights(world, state)[slots, receivers], (len(slots), episodes.count))
        arrived = estimates[senders] if state.received is None else state.received.messages[slots, :, receivers, :kept]
        instants.append({
            "strategies": estimates[own],
            "estimates": estimates.copy(),
            "inputs": np.full(estimates.shape, np.nan) if held is None else held[..., :kept].swapaxes(0, 1).copy(),
            "weights": weights[:, :kept],
            "messages": (arrived - estimates[receivers]) * (weights[:, None, :kept] > 0),
        })  # fmt: skip

    team = None if track.teammates is None else track.teammates.join(world)
    try:
        policy = spec.build(encoder.layout)
    except LayoutError as error:
        raise LayoutError(f"{spec.name} cannot act on {track.name}: {error}") from error
    played = rollout(policy, encoder, start, team, watch)
    return Trajectories(
        policy=spec.name,
        episodes=episodes,
        rollout=played,
        t=clock.t,
        s=clock.s,
        tau=np.concatenate([[0.0], np.cumsum(clock.theta[:-1])]),
        links=np.column_stack([receivers, senders]),
        nash_equilibria=np.broadcast_to(start.game.nash_equilibria, (len(owners), episodes.count))[:, :kept],
        errors=played["estimate_distance"],
        strategy_errors=played["strategy_distance"],
        **{name: np.stack([instant[name] for instant in instants]) for name in instants[0]},
    )
