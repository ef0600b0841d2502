"""The dynamics: the state of B environments as a frozen record, and the pure transition that advances it.

>>> state = initial_state(world, estimates)
>>> state = step(world, state, inputs)

Arrays are float64 with environments last. Every function here depends on its arguments alone. In shapes, B counts
environments, N players, n components of x, D neighbour slots, K steps to the deadline, H steps of the hold phase, and G
games: 1, or B where every environment has its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ptne_env.games import Game
from ptne_env.shared.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    array_namespace,
    is_numpy,
    replace_columns,
    without_gradient,
)
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world.channels import LinkRandomness, Memory, Messages
from ptne_env.world.disturbances import Disturbance
from ptne_env.world.world import RANGE_LIMIT, ComponentOrder, EpisodeRandomness, World

PHYSICS = 1
"""The version of the behaviour of worlds, part of the key of stored results. When the behaviour changes, tests of
stored trajectories (``tests/data/golden.json``) fail until this number rises and they are written anew."""


class Received(NamedTuple):
    """Messages at the receiving end of a channel that is not perfect.

    Attributes:
        messages: x^j as received in each neighbour slot, shape (D, n, N, B).
        weights: a_ij of the receiver, shape (D, N, B); 0 where it receives nothing.
        memory: what the channel remembers.
    """

    messages: FloatArray
    weights: FloatArray
    memory: Memory


class State(NamedTuple):
    """The state of B environments. Its arrays are never changed: a step makes new ones.

    Attributes:
        step: the index of the coming step, 0..K+H, shape (B,), int64.
        game: the games that are played, one for all environments or one for each.
        estimates: x^i in column i, shape (n, N, B); the diagonal blocks are the strategies.
        own_gradients: ∂J_i/∂x_i(x^i), blocks stacked, shape (n, B).
        diverged: whether the environment has left the range, after which it stays where it is, shape (B,).
        any_diverged: whether any environment has.
        randomness: what the episodes draw besides game and start; ``None`` where a scenario draws nothing else.
        received: the messages that came through the channel; ``None`` where it is perfect.
    """

    step: IntArray
    game: Game
    estimates: FloatArray
    own_gradients: FloatArray
    diverged: BoolArray
    any_diverged: bool = False
    randomness: EpisodeRandomness | None = None
    received: Received | None = None


def draw_initial_state(world: World, streams: Sequence[RandomStreams], estimates: FloatArray | None = None) -> State:
    """Draw the game, start and randomness of episodes, one per entry of ``streams``, and return their state at t = 0.

    Initial ``estimates``, shape (n, N, B), replace drawn ones. Raises as :meth:`World.draw_game` and
    :func:`initial_state`.
    """
    game = world.draw_game(streams)
    if estimates is None:
        estimates = world.draw_estimates(streams)
    return initial_state(world, estimates, game, world.draw_randomness(streams))


def initial_state(
    world: World, estimates: FloatArray, game: Game | None = None, randomness: EpisodeRandomness | None = None
) -> State:
    """Return the state at t = 0.

    Args:
        world: the scenario, built.
        estimates: initial estimates, shape (n, N, B). Strategies outside the box of the game are projected into it.
        game: one game or B games; needed where the scenario draws games.
        randomness: the remaining draws of B episodes; needed where :meth:`World.draw_randomness` draws any.

    Raises:
        ValueError: when a shape is wrong, an estimate or own gradient is not finite or outside the range, or a draw is
            missing.
    """
    name, expected = world.scenario.name, (world.game.dimension, world.game.num_players)
    if estimates.ndim != 3 or estimates.shape[:2] != expected:
        raise ValueError(f"initial estimates have the shape {(*expected, 'B')}, got {estimates.shape}")
    if not np.all(np.abs(estimates) <= RANGE_LIMIT):
        raise ValueError(f"initial estimates must be finite and within ±{RANGE_LIMIT:g}")
    batch = estimates.shape[2]
    if game is None:
        if world.has_random_game:
            raise ValueError(f"scenario {name!r} draws games: pass the games to play, see World.draw_game()")
        game = world.game
    if game.batch_size not in (1, batch) or game.action_dims != world.game.action_dims:
        raise ValueError(f"{batch} environments need one game or {batch}, got {game.batch_size}")
    if world.has_episode_randomness and (randomness is None or randomness.channel_keys.shape != (batch,)):
        raise ValueError(
            f"scenario {name!r} draws more than games and starts: pass the draws of {batch} environments, see "
            "World.draw_randomness()"
        )
    # A copy, so that the caller cannot change the state. It is C-contiguous, as drawn estimates are: the last bits of
    # sums depend on the order in memory.
    state = begin(world, np.array(estimates, dtype=np.float64, order="C"), game, randomness)
    if state.any_diverged:
        raise ValueError(f"own gradients at the initial estimates must be within ±{RANGE_LIMIT:g}: start closer")
    return state


def begin(world: World, estimates: FloatArray, game: Game, randomness: EpisodeRandomness | None) -> State:
    """Do what :func:`initial_state` does without checks; numpy's estimates may be changed in place."""
    batch, xp = estimates.shape[2], array_namespace(estimates)
    step, diverged = xp.zeros(batch, dtype=np.int64), xp.zeros(batch, dtype=np.bool_)
    gradients: Any = None  # they follow
    before = State(step, game, estimates, gradients, diverged, randomness=randomness)
    return _complete(world, before, step, _project(estimates, game))


def restore(world: World, state: State, batch: int) -> State:
    """Return a state, such as a saved one, that fits a world and has ``batch`` environments, with its own gradients.

    Its game may be another one than that of the world: a single environment plays any game of the same players, and
    several play the world's game, or one each that differs from it in its parameters alone. The memory of a channel is
    not checked.

    Raises:
        ValueError: when it is no state, has another shape, a step or estimates out of range, other games, or draws and
            messages that the world lacks or needs.
    """
    if not isinstance(state, State):
        raise ValueError(f"a state is a ptne_env.world.dynamics.State, got {type(state).__name__}")
    known, last = world.game, world.clock.total_steps
    expected = known.dimension, known.num_players, batch
    for name, kinds, shape in (
        ("step", "iu", (batch,)),
        ("estimates", "f", expected),
        ("own_gradients", "f", (known.dimension, batch)),
        ("diverged", "b", (batch,)),
    ):
        array = np.asarray(getattr(state, name))
        if array.shape != shape or array.dtype.kind not in kinds:
            what = f"of shape {shape} and a dtype of kind {kinds!r}"
            raise ValueError(f"a state of this environment has {name} {what}, got {array.dtype} of shape {array.shape}")
    if not isinstance(state.game, Game):
        raise ValueError(f"the game of a state is a Game, got a {type(state.game).__name__}")
    if not np.all((state.step >= 0) & (state.step <= last)):
        raise ValueError(f"a step of this environment is 0 to {last}, got {state.step.tolist()}")
    if not _in_range(state.estimates):
        raise ValueError(f"the estimates of a state must be finite and within ±{RANGE_LIMIT:g}")
    modes: Any = None if state.randomness is None else state.randomness.modes
    messages: Any = None if state.received is None else state.received.messages
    fits = {
        "players and dimensions": state.game.action_dims == known.action_dims,
        "random draws": (state.randomness is not None) == world.has_episode_randomness,
        "active graphs": np.shape(modes) == ((last + 1, batch) if world.topology.is_random else ())
        and (modes is None or modes.max() < len(world.topology.graphs)),
        "received messages": np.shape(messages) == (() if world.channel.is_perfect else (world.slots, *expected)),
    }
    faults = [name for name, is_so in fits.items() if not is_so]
    if faults:
        raise ValueError(
            f"the state is of another world: its {', '.join(faults)} are not those of scenario {world.scenario.name!r}"
        )
    game, parameters = state.game, {name: getattr(known, name) for name in known.parameters}
    is_alike = batch == 1 or (type(game) is type(known) and game.with_columns(parameters) == known)
    if batch > 1 and game.batch_size == 1 and game == known:
        game = known  # so that environments can be replaced one by one
    elif game.batch_size != batch or not is_alike:
        raise ValueError(
            f"{batch} environments play {known!r}, or a batch of {batch} games that differ from it in "
            f"{', '.join(known.parameters) or 'nothing'}, got {game!r}"
        )
    gradients = np.where(state.diverged, state.own_gradients, _own_gradients(game, state.estimates))
    diverged = state.diverged | ~_is_near(state.estimates, gradients)
    return copy(state._replace(game=game, own_gradients=_clip(gradients), diverged=diverged))


def step(world: World, state: State, inputs: FloatArray) -> State:
    """Return the state after one step, x_{k+1} = x_k + Θ_k u_k, which is exact for the held input.

    Disturbances, boxes and channels act as the world says. Where a box confines the strategies, the players' own blocks
    of x_k + Θ_k u_k are projected into it. The ``inputs`` u_k are finite and have the shape (n, N, B).
    """
    theta = world.clock.theta[shared_step(state)]
    if state.any_diverged:
        theta = array_namespace(theta).where(state.diverged, 0.0, theta)
    estimates = theta * inputs
    estimates += state.estimates
    if world.disturbance is not None:
        estimates = _disturb(world, world.disturbance, estimates, state)
    return _complete(world, state, world.next_step[state.step], _project(estimates, state.game))


def merge(state: State, fresh: State, mask: BoolArray) -> State:
    """Replace the environments in ``mask`` (B,), in order, by all those of ``fresh``."""
    return _map_arrays(lambda old, new: replace_columns(old, new, mask), state, fresh)


def concatenate(states: Sequence[State]) -> State:
    """Return the state of all environments of several states, in order, in arrays of its own."""

    def join(*arrays: Any) -> Any:  # those of a game that serves a whole state have one column
        row = max((array.shape[:-1] for array in arrays), key=len)
        wide = [np.broadcast_to(array, (*row, batch_size(state))) for array, state in zip(arrays, states, strict=True)]
        return np.concatenate(wide, axis=-1)

    return _map_arrays(join, *states)


def copy(state: State) -> State:
    """Return the state in arrays of its own, but with its game, which never changes and knows its equilibria."""
    return select(state, slice(None))._replace(game=state.game)


def select(state: State, environments: slice) -> State:
    """Return the state of some of the environments, in arrays of its own."""
    return _map_arrays(lambda array: array[..., environments].copy(), state)


def _map_arrays(function: Callable[..., Any], *states: State) -> State:
    """Return the state whose arrays, and parameters of games, are a function of those of other states."""

    def call(first: Any, *others: Any) -> Any:
        if isinstance(first, tuple):
            values = [call(*parts) for parts in zip(first, *others, strict=True)]
            return first._make(values) if hasattr(first, "_make") else tuple(values)
        if isinstance(first, Game):
            return first.map_columns(function, *others)
        return first if first is None or isinstance(first, bool) else function(first, *others)

    mapped: State = call(*states)
    return mapped._replace(any_diverged=bool(mapped.diverged.any()))


def batch_size(state: State) -> int:
    """Return B."""
    return state.estimates.shape[2]


def shared_step(state: State) -> IntArray:
    """Return ``state.step``, shape (B,), or one entry, shape (1,), where all environments are at the same step."""
    steps = state.step
    in_lockstep = steps.size == 1 or (is_numpy(steps) and np.count_nonzero(steps != steps[0]) == 0)
    return steps[:1] if in_lockstep else steps


def is_over(world: World, state: State) -> BoolArray:
    """Return whether each environment has reached its end or diverged, shape (B,)."""
    finished = world.is_last_step[state.step]
    return finished | state.diverged if state.any_diverged else finished


def strategies(state: State) -> FloatArray:
    """Return the real strategies x, shape (n, B)."""
    return _own(state.game, state.estimates)


def active_mode(world: World, state: State) -> IntArray:
    """Return the index of the active graph, shape (B,), int64."""
    if state.randomness is None or state.randomness.modes is None:
        return world.modes[state.step]
    return state.randomness.modes[state.step, np.arange(state.step.size)].astype(np.int64)


def time_since_switch(world: World, state: State) -> FloatArray:
    """Return the time since the last switch over the mean dwell, clipped to [0, 1], 0 for a fixed graph; (B,)."""
    if state.randomness is None or state.randomness.time_since_switch is None:
        return world.time_since_switch[state.step]
    return state.randomness.time_since_switch[state.step, np.arange(state.step.size)].astype(np.float64)


def graph_weights(world: World, state: State) -> FloatArray:
    """Return a_ij of the active graph per neighbour slot, (D, N, B), or (D, N, 1) where all environments agree."""
    if world.mode_weights.shape[2] == 1:
        return world.mode_weights
    modes = active_mode(world, state) if world.topology.is_random else world.modes[shared_step(state)]
    return world.mode_weights.take(modes, axis=2)


def weights(world: World, state: State) -> FloatArray:
    """Return a_ij of the receiver per neighbour slot, (D, N, B), or (D, N, 1) where all environments agree."""
    return graph_weights(world, state) if state.received is None else state.received.weights


def sent_messages(world: World, estimates: FloatArray) -> FloatArray:
    """Return the x^j of the neighbour in each slot: estimates (n, N, B) to (D, n, N, B)."""
    return estimates.reshape(-1, estimates.shape[2]).take(world.component_order.senders, axis=0)


def relative_estimates(
    world: World,
    state: State,
    link_weights: FloatArray | None = None,
    *,
    order: ComponentOrder | None = None,
    out: FloatArray | None = None,
) -> FloatArray:
    """Return (x^j as received) − x^i per neighbour slot in float64, 0 where the link is down, shape (D, n, N, B).

    The caller may pass the :func:`weights` of the state, another order of each player's components than that of the
    game, and a C-contiguous array to write into.
    """
    rows, received = state.estimates.reshape(-1, batch_size(state)), state.received
    own = state.estimates if order is None else rows.take(order.own, axis=0)
    if received is None:
        senders = (order or world.component_order).senders
        relative = rows.take(senders, axis=0, out=out, mode="clip")  # mode "raise" would copy once more
        relative -= own
    elif order is None:
        relative = received.messages - own if out is None else np.subtract(received.messages, own, out=out)
    else:
        messages = received.messages.reshape(world.slots, -1, rows.shape[1])
        relative = messages.take(order.own, axis=1, out=out, mode="clip")
        relative -= own
    if not world.has_constant_weights:
        link_weights = weights(world, state) if link_weights is None else link_weights
        relative *= (link_weights > 0)[:, None]
    return relative


def distance_limit(game: Game) -> FloatArray:
    """Return the relative distance of a diverged environment, beyond that of any state in range; shape (G,)."""
    scale = game.equilibrium_scale
    return (RANGE_LIMIT * np.sqrt(game.dimension) + scale) / scale


def _complete(world: World, before: State, step: IntArray, estimates: FloatArray) -> State:
    """Return the state with these estimates, from which own gradients, divergence and received messages follow."""
    game, diverged, any_diverged = before.game, before.diverged, before.any_diverged
    gradients = _own_gradients(game, estimates)
    if not (_in_range(estimates) and _in_range(gradients)):
        diverged = diverged | ~_is_near(estimates, gradients)
        any_diverged = not is_numpy(diverged) or bool(diverged.any())
        estimates, gradients = _clip(estimates), _clip(gradients)
    state = State(step, game, estimates, gradients, diverged, any_diverged, before.randomness)
    if world.channel.is_perfect:
        return state
    memory = None if before.received is None else before.received.memory
    return state._replace(received=_transmit(world, state, memory))


def _own_gradients(game: Game, estimates: FloatArray) -> FloatArray:
    """Return the own gradients, shape (n, B), not finite where a game overflows."""
    if game.is_affine:
        return game.own_gradients(estimates)
    with np.errstate(over="ignore", invalid="ignore"):  # a diverging game may overflow; it is caught by the caller
        gradients = game.own_gradients(estimates)
    if is_numpy(estimates):
        return gradients
    # JAX multiplies a cotangent of 0 by a derivative that is not finite; so games that overflow get none.
    gradients, xp = without_gradient(gradients), array_namespace(estimates)
    is_near = _is_near(estimates, gradients)
    safe: FloatArray = game.own_gradients(xp.where(is_near, estimates, game.nash_equilibria[:, None]))
    return xp.where(is_near, safe, gradients)


def _is_near(estimates: FloatArray, gradients: FloatArray) -> BoolArray:
    """Return whether each environment's estimates (n, N, B) and own gradients (n, B) are in range, shape (B,)."""
    xp = array_namespace(estimates)
    farthest = xp.maximum(xp.abs(estimates).max(axis=(0, 1)), xp.abs(gradients).max(axis=0))
    return farthest <= RANGE_LIMIT


def _clip(array: FloatArray) -> FloatArray:
    """Clip numbers to ±RANGE_LIMIT; NaN becomes RANGE_LIMIT."""
    xp = array_namespace(array)
    return xp.clip(xp.nan_to_num(array, nan=RANGE_LIMIT), -RANGE_LIMIT, RANGE_LIMIT)


def _transmit(world: World, state: State, memory: Memory | None) -> Received:
    """Send the messages of a state through the channel, which remembers ``memory`` of the step before."""
    batch, xp = batch_size(state), array_namespace(state.estimates)
    keys = xp.zeros(batch, dtype=np.uint64) if state.randomness is None else state.randomness.channel_keys
    link_weights = graph_weights(world, state)
    link_weights = xp.broadcast_to(link_weights, (*link_weights.shape[:2], batch))
    randomness = LinkRandomness(keys, state.step, world.neighbours, world.game.owners)
    sent = Messages(sent_messages(world, state.estimates), link_weights > 0, link_weights)
    received, memory = world.channel.transmit(sent, memory, randomness)
    values = received.values
    if not _in_range(values):  # noise may leave the range that observations are bounded by
        values = xp.clip(values, -RANGE_LIMIT, RANGE_LIMIT)
    # A down link delivers nothing, including messages in transit.
    return Received(values, received.weights * (received.live & sent.live), memory)


def _disturb(world: World, disturbance: Disturbance, estimates: FloatArray, state: State) -> FloatArray:
    """Add Δt w to the real strategies, perhaps in place."""
    steps, xp = shared_step(state), array_namespace(estimates)
    dt = xp.where(state.diverged, 0.0, world.clock.dt[steps])
    batch = batch_size(state)
    keys = xp.zeros(batch, dtype=np.uint64) if state.randomness is None else state.randomness.disturbance_keys
    push = dt * disturbance.velocity(keys, state.step, world.game.dimension)
    return _replace_own(state.game, estimates, _own(state.game, estimates) + push)


def _project(estimates: FloatArray, game: Game) -> FloatArray:
    """Project the real strategies into the game's box, perhaps in place; other estimates stay."""
    return estimates if game.box is None else _replace_own(game, estimates, game.project(_own(game, estimates)))


def _own(game: Game, estimates: FloatArray) -> FloatArray:
    """Return the real strategies in estimates (n, N, B), shape (n, B)."""
    return estimates[np.arange(game.dimension), game.owners]


def _replace_own(game: Game, estimates: FloatArray, strategies: FloatArray) -> FloatArray:
    """Replace the real strategies in estimates (n, N, B) by others (n, B); numpy's estimates are changed in place."""
    if is_numpy(estimates):
        estimates[np.arange(game.dimension), game.owners] = strategies
        return estimates
    is_own = (game.owners[:, None] == np.arange(game.num_players))[:, :, None]
    return array_namespace(estimates).where(is_own, strategies[:, None], estimates)


def _in_range(array: FloatArray) -> bool:
    """Return whether every entry is a number within ±RANGE_LIMIT."""
    if not is_numpy(array):  # JAX does not know numbers before it runs
        return False
    flat = array.reshape(-1)
    # Σ x² ≤ limit² is enough, costs one pass and is False for NaN. (einsum and not dot: BLAS would wake its threads.)
    if np.einsum("i,i->", flat, flat) <= RANGE_LIMIT**2:
        return True
    return bool(np.maximum.reduce(flat) <= RANGE_LIMIT and np.minimum.reduce(flat) >= -RANGE_LIMIT)
