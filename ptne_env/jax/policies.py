"""Policies as pure functions of one player's observation, the paper's laws among them, and the loop that runs them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ptne_env.jax.environment import JaxWorld
from ptne_env.laws.adaptive import Adaptive, adaptive_inputs
from ptne_env.laws.static import static_inputs
from ptne_env.perception.observation import Interface, LayoutError, ObservationLayout
from ptne_env.perception.policy import RowPolicy
from ptne_env.shared.arrays import BoolArray, Float32Array
from ptne_env.world.dynamics import State
from ptne_env.world.rewards import RewardChoice

Act = Callable[[Any, jax.Array, Any], tuple[jax.Array, Any]]
"""``act(params, observation, memory) -> (action, memory)`` of one player: (size,) to (n,)."""


@dataclass(frozen=True)
class JaxPolicy(RowPolicy):
    """A pure function with its parameters; a pytree, so that JAX differentiates and maps it by its parameters.

    It has ``predict``, as every policy, so it may be an entry of :func:`ptne_env.evaluate`:
    ``PolicySpec("mine", policy)``.

    Attributes:
        act: the function ``act(params, observation, memory) -> (action, memory)``, which decides for one player from
            its observation (size,) and its own memory alone. Actions (n,) are in the units of the interface, and are
            clipped.
        params: the first argument of ``act``; any pytree.
        memory: the memory of a player at the start of an episode; any pytree, ``()`` for none.
        interface: the interface of observations and actions.
        layout: the layout for which ``act`` was made; ``None`` where it does not matter.
    """

    act: Act
    params: Any = ()
    memory: Any = ()
    interface: Interface = field(default_factory=Interface)
    layout: ObservationLayout | None = None

    @property
    def made_for(self) -> Mapping[str, Any]:  # type: ignore[override]  # it is frozen, and derives it
        """The size, interface, players and neighbour slots of its layout, if it has one."""
        names = ("size", "interface", "action_dims", "slots") if self.layout is not None else ()
        return {name: getattr(self.layout, name) for name in names}

    def decide(self, rows: Float32Array, memory: Any, starts: BoolArray, *, deterministic: bool) -> tuple[Any, Any]:  # noqa: ARG002 - ``act`` is deterministic
        """Return the actions and the memory; see :meth:`ptne_env.perception.policy.RowPolicy.decide`."""
        if memory is None:
            memory = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (len(rows), *np.shape(leaf))), self.memory)
        return self._decide(self.params, self.memory, rows, memory, starts)

    @cached_property
    def _decide(self) -> Any:
        def decide(params: Any, first: Any, rows: jax.Array, memory: Any, starts: jax.Array) -> Any:
            def one(row: tuple[Any, ...]) -> tuple[jax.Array, Any]:
                observation, remembered, is_start = row
                remembered = jax.tree.map(lambda old, new: jnp.where(is_start, new, old), remembered, first)
                return self.act(params, observation, remembered)

            return jax.lax.map(one, (rows, memory, starts))  # row by row, so that no bit depends on other rows

        return jax.jit(decide)


jax.tree_util.register_dataclass(JaxPolicy, ["params", "memory"], ["act", "interface", "layout"])


class JaxRollout(NamedTuple):
    """Episodes of a policy.

    Attributes:
        state: at the end.
        memory: of all players at the end, the last axes being (N, B).
        rewards: of every step, shape (steps, N, B).
        digits: of each episode after every step, shape (steps, B).
    """

    state: State
    memory: Any
    rewards: jax.Array
    digits: jax.Array


def rollout(
    world: JaxWorld,
    policy: JaxPolicy,
    key: jax.Array | State,
    num_envs: int = 1,
    *,
    steps: int | None = None,
    reward: RewardChoice = "digits",
    memory: Any = None,
) -> JaxRollout:
    """Run a policy through whole episodes: every player decides, all inputs are held for a step, and again.

    It is compiled once for a world, a function ``act`` and the other arguments that are no arrays.

    Args:
        world: with the interface of the policy.
        policy: decides for all players.
        key: draws the episodes; or the state from which they go on.
        num_envs: B, if a key is given.
        steps: number of steps; to the end of the episodes if left out.
        reward: as for :meth:`JaxWorld.rewards`.
        memory: of all players, with which they go on; that of a start if left out.

    Raises:
        LayoutError: when the policy acts through another interface than the world's, or in another world.
    """
    if policy.interface != world.layout.interface:
        raise LayoutError(f"the policy acts through {policy.interface}, and the world has {world.layout.interface}")
    kept = tuple(reward.items()) if isinstance(reward, Mapping) else reward  # as JAX finds compiled functions by it
    return _run(world, policy.with_layout(world.layout), key, num_envs, steps, kept, memory)


@partial(jax.jit, static_argnames=("world", "num_envs", "steps", "reward"))
def _run(
    world: JaxWorld,
    policy: JaxPolicy,
    key: jax.Array | State,
    num_envs: int,
    steps: int | None,
    reward: Any,
    memory: Any,
) -> JaxRollout:
    chosen = dict(reward) if isinstance(reward, tuple) else reward
    of_player = jax.vmap(policy.act, in_axes=(None, -1, -1), out_axes=-1)
    of_all = jax.vmap(of_player, in_axes=(None, -1, -1), out_axes=-1)

    def step(carry: tuple[State, Any], _: None) -> tuple[tuple[State, Any], tuple[jax.Array, jax.Array]]:
        state, memory = carry
        actions, memory = of_all(policy.params, world.observe(state), memory)
        after = world.step(state, world.inputs(state, actions))
        return (after, memory), (world.rewards(state, after, chosen), world.digits(after))

    state = key if isinstance(key, State) else world.reset(key, num_envs)
    if memory is None:
        rows = state.estimates.shape[1:]
        memory = jax.tree.map(
            lambda leaf: jnp.broadcast_to(jnp.asarray(leaf)[..., None, None], (*jnp.shape(leaf), *rows)), policy.memory
        )
    count = world.numpy.clock.total_steps if steps is None else steps
    # A gradient computes each step again instead of storing its numbers, which is faster, as they stay in the cache.
    again = jax.checkpoint(step, prevent_cse=False)
    (state, memory), (rewards, digits) = jax.lax.scan(again, (state, memory), length=count)
    return JaxRollout(state, memory, rewards, digits)


def static(layout: ObservationLayout, kappa: float = 2.0, gradient_gain: float = 1.0) -> JaxPolicy:
    """The law :class:`ptne_env.laws.Static`; its parameters are κ and g."""

    def act(params: Any, observation: jax.Array, memory: Any) -> tuple[jax.Array, Any]:
        return static_inputs(layout.read(observation), **params), memory

    return _law(layout, act, {"kappa": kappa, "gradient_gain": gradient_gain})


def adaptive(layout: ObservationLayout, gamma: npt.ArrayLike = 0.01, initial_gain: npt.ArrayLike = 0.5) -> JaxPolicy:
    """The law :class:`ptne_env.laws.Adaptive`; its parameters are γ_ij and the surplus of κ_ij(0), rows of players."""
    law = Adaptive(layout, gamma, initial_gain)

    def act(params: Any, observation: jax.Array, memory: jax.Array) -> tuple[jax.Array, jax.Array]:
        seen = layout.read(observation)
        return adaptive_inputs(seen, memory, **{name: jnp.asarray(rows)[seen.player] for name, rows in params.items()})

    return _law(layout, act, {"gamma": law.gamma, "surplus": law.surplus}, law.initial_memory(1)[0])


def _law(layout: ObservationLayout, act: Act, params: Any, memory: Any = ()) -> JaxPolicy:
    if layout.is_scaled:
        raise LayoutError("the laws act in natural units: make the world with interface='physical'")
    return JaxPolicy(act, params, memory, layout.interface, layout)
