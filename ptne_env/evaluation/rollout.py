"""Running a policy through a batch of episodes, and recording series on the way."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

from ptne_env.evaluation.audit import Witness
from ptne_env.evaluation.metrics import SERIES, Moment, Rollout, instants
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.policy import Policy, PolicyError, decision, describe
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray
from ptne_env.world import dynamics
from ptne_env.world.dynamics import State


class Member:
    """A policy that decides for some of the players through its own encoder.

    The policy is called with ``deterministic=True``, and its memory is passed back to it unread.

    Args:
        policy: built for the layout of ``encoder``.
        encoder: makes its observations and decodes its actions.
        players: indices of the players for which it decides.
        witnesses: audit the decisions.

    Attributes:
        seconds: wall time of the policy so far.
    """

    def __init__(
        self, policy: Policy, encoder: Encoder, players: Sequence[int], witnesses: Sequence[Witness] = ()
    ) -> None:
        self.policy, self.encoder = policy, encoder
        self.players = np.array(players, dtype=np.int64)
        self.witnesses = witnesses
        self.seconds = 0.0
        self._memory: Any = None
        self._episode_start: BoolArray | None = None

    def decide(self, state: State) -> FloatArray:
        """Inputs u of shape (n, N, B), 0 for all other players.

        Raises:
            PolicyError: when the policy raises, returns actions of another shape or actions that are not finite, or
                does not pass the audit.
        """
        layout, batch = self.encoder.layout, dynamics.batch_size(state)
        rows = len(self.players) * batch
        is_alone = len(self.players) == layout.num_players
        if self._episode_start is None:
            self._episode_start = np.ones(rows, dtype=np.bool_)
        observations = self.encoder.observe(state)
        if not is_alone:
            observations = observations[:, self.players]
        shape = (batch, len(self.players), layout.action_size)
        try:
            chosen = self._ask(observations.reshape(rows, -1)).reshape(shape)
        except PolicyError as error:
            raise PolicyError(f"step {int(state.step[0])}: {error}") from error
        except MemoryError:
            raise
        except Exception as error:  # of the policy or of a witness
            raise PolicyError(f"step {int(state.step[0])}: {describe(error)}") from error
        if is_alone:
            return self.encoder.decode(chosen, state)
        actions_of_all = np.zeros((batch, layout.num_players, layout.action_size), dtype=chosen.dtype)
        actions_of_all[:, self.players] = chosen
        inputs = np.zeros_like(state.estimates)
        inputs[:, self.players] = self.encoder.decode(actions_of_all, state)[:, self.players]
        return inputs

    def _ask(self, observations: Float32Array) -> npt.NDArray[Any]:
        """The actions for observations of shape (R, size), checked and audited: shape (R, action size)."""
        started = perf_counter()
        actions, self._memory = decision(
            self.policy, observations, self._memory, self._episode_start, deterministic=True
        )
        self.seconds += perf_counter() - started
        self._episode_start = np.zeros_like(self._episode_start)
        chosen, expected = np.asarray(actions), (len(observations), self.encoder.layout.action_size)
        if chosen.shape != expected:
            raise PolicyError(
                f"it answered {expected[0]} observations with actions of shape {chosen.shape}; expected {expected}"
            )
        if not np.isfinite(chosen).all():
            raise PolicyError("it answered with an action that is not finite; expected numbers without NaN or inf")
        for witness in self.witnesses:
            witness.compare(observations, chosen)
        return chosen


def rollout(
    policy: Policy,
    encoder: Encoder,
    start: State,
    teammates: Member | None = None,
    watch: Callable[[State, FloatArray | None], None] | None = None,
    witnesses: Sequence[Witness] = (),
    series: Iterable[str] | None = None,
) -> Rollout:
    """Run ``policy`` from the state ``start`` at t = 0 to the end of every episode.

    Args:
        policy: the policy that is measured.
        encoder: makes its observations and decodes its actions.
        start: initial state of all episodes.
        teammates: decide for their players in place of ``policy``, which decides for the other players only.
        watch: called with every state and the inputs (n, N, B) that are held from it, ``None`` with the last state.
        witnesses: audit the decisions of ``policy``.
        series: names of those that are recorded; all if left out.

    Raises:
        PolicyError: when a policy raises, returns actions of another shape or actions that are not finite, or does not
            pass the audit.
    """
    world, batch = encoder.world, dynamics.batch_size(start)
    clock, players = world.clock, range(world.game.num_players)
    taken = set() if teammates is None else set(teammates.players.tolist())
    member = Member(policy, encoder, [player for player in players if player not in taken], witnesses)
    recorded = {name: instants(name, clock) for name in (SERIES if series is None else series)}
    values = {name: np.empty((len(chosen), batch)) for name, chosen in recorded.items()}
    state = start
    for step in range(clock.total_steps + 1):
        inputs = member.decide(state) if step < clock.total_steps else None
        if teammates is not None and inputs is not None:
            inputs += teammates.decide(state)
        if watch is not None:
            watch(state, inputs)
        moment = Moment(world, state, inputs, step)
        for name, chosen in recorded.items():
            if step in chosen:
                values[name][chosen.index(step)] = SERIES[name][1](moment)
        if inputs is not None:
            state = dynamics.step(world, state, inputs)
    seconds = member.seconds / (clock.total_steps * len(member.players) * batch)
    return Rollout(world, values, state.diverged, seconds)
