"""Ceilings: mean digits that no policy passes, whatever it computes and remembers.

A bound is on the mean of the digits −log10 d over episodes, d = ‖𝐱 − 1⊗x*‖/(√N ‖x*‖). Each has a proof of a few
sentences, and holds up to float32 rounding of observations and actions. Most proofs give the policy everything but one
random quantity w that enters the final estimates or their target by addition, is independent of all that the policy
sees, and whose density is symmetric and unimodal. By T. W. Anderson, "The integral of a symmetric unimodal function
over a symmetric convex set", Proceedings of the American Mathematical Society 6(2), 1955, P(‖w − a‖ ≤ r) is largest at
a = 0 for every r. So E[−log10 ‖w − a‖] ≤ E[−log10 ‖w‖], which sampling evaluates.

Where no bound holds, a ceiling is infinite, and results are limited by :data:`~ptne_env.world.distances.FLOOR` alone. In
particular neither noise nor rounding of messages gives a ceiling: see :func:`message_bits`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ptne_env.games import EnergyGame, RandomEnergy
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, require_non_negative
from ptne_env.world.channel import AdditiveNoise, Chain, Channel, UniformQuantiser
from ptne_env.world.disturbances import UniformDisturbance
from ptne_env.world.dynamics import State
from ptne_env.world.sensor import GradientNoise
from ptne_env.world.world import RANGE_LIMIT, World

_SAMPLES = 4000
"""Draws by which a mean of −log10 ‖w‖ is found; its standard error is below 0.01 digits."""

_FLOAT_BITS = 32.0
"""Bits of a number that is received exactly: observations are float32."""

_TAIL = 5.0
"""Standard deviations beyond which Gaussian noise is neglected; its probability there is below 1e-6."""


def reach_digits(world: World, state: State, instant: int) -> FloatArray:
    """The ceiling of limited inputs, episode by episode; shape (B,), infinite where all estimates can arrive.

    Proof: In step k an estimate moves by Θ_k u with |u| ≤ ū, and a box only shortens that. So after the steps before
    ``instant`` every entry of 𝐱 − 1⊗x* is at least |x^i_c(0) − x*_c| − ū Σ_k Θ_k. Where a game has several equilibria,
    the one that is nearest in this sense counts. There is no bound where strategies are pushed or the game drifts.

    Args:
        world: the world.
        state: the initial state.
        instant: of the measurement, in steps.
    """
    game, players = state.game, world.game.num_players
    if not world.disturbance.is_absent or world.drift is not None:
        return np.full(state.step.size, np.inf)
    reach = world.input_limit * world.theta[..., :instant].sum(axis=-1)
    targets = [game.nash_equilibria, *(() if game.other_equilibria is None else game.other_equilibria)]
    missing = [
        np.maximum(np.abs(state.estimates - target[:, None]) - np.reshape(reach, (1, -1, 1)), 0.0) for target in targets
    ]
    squares = np.min([np.einsum("nib,nib->b", part, part) for part in missing], axis=0)
    return _digits_of(np.sqrt(squares)) + _scale_digits(state, players)


def push_digits(world: World, state: State, instant: int) -> FloatArray:
    """The ceiling of a push that no observation shows in time; shape (B,), infinite where there is none.

    Proof: A push w Δt that is drawn anew in the last step before ``instant`` is added to the strategies after the last
    decision, independently of all before, uniformly on a cube. Anderson's theorem gives E[−log10 ‖w‖] Δt. A push that
    was drawn in an earlier step can be measured and answered, so it gives no ceiling; neither does a game with a box,
    which can hold the strategies.

    Args:
        world: the world.
        state: the initial state.
        instant: of the measurement, in steps.
    """
    pushes, last = world.disturbance, instant - 1
    if not isinstance(pushes, UniformDisturbance) or last % pushes.dwell or world.game.has_bounds:
        return np.full(state.step.size, np.inf)
    if pushes.after_deadline_only and last < world.clock.steps:
        return np.full(state.step.size, np.inf)
    largest = pushes.bound * world.clock.dt[last]
    cube = np.random.default_rng(0).uniform(-largest, largest, (_SAMPLES, world.game.dimension))
    return _digits_of(np.linalg.norm(cube, axis=1)).mean() + _scale_digits(state, world.game.num_players)


def teammate_digits(world: World, state: State, instant: int, players: Sequence[int], kappa: float) -> FloatArray:
    """The ceiling of teammates that follow the static law over noisy links; shape (B,), infinite without noise.

    Proof: In the last step before ``instant`` the law of teammate j adds Θ κ Σ_d a_jd ξ_d to its estimate, where ξ_d is
    the noise of the last message on link d, which no other player sees and no later decision answers. The other parts
    of the final estimates are independent of it, so Anderson's theorem holds of the estimates of all teammates.

    Args:
        world: the world; a channel other than additive noise, or a game with a box, gives no ceiling.
        state: the initial state.
        instant: of the measurement, in steps.
        players: the teammates.
        kappa: κ of their law.
    """
    last, chosen, n = instant - 1, list(players), world.game.dimension
    if not isinstance(world.channel, AdditiveNoise) or world.game.has_bounds:
        return np.full(state.step.size, np.inf)
    weights = world.mode_weights[:, chosen][..., _modes(world, state)[last]]
    theta = np.broadcast_to(world.theta[..., last], world.game.num_players)[chosen]
    variances = (theta[:, None] * kappa * world.channel.std) ** 2 * np.einsum("dpb,dpb->pb", weights, weights)
    squares = np.random.default_rng(0).chisquare(n, (_SAMPLES, len(chosen))) @ variances
    return _digits_of(np.sqrt(squares)).mean(axis=0) + _scale_digits(state, world.game.num_players)


def sensor_digits(world: World, state: State, instant: int) -> FloatArray:
    """The ceiling of noisy own gradients for policies that do not see their own payoff; shape (B,).

    Proof: Give the policy all parameters of a game of :class:`~ptne_env.games.RandomEnergy` but the targets b, which
    the players' own gradients alone depend on: ∂J_i/∂x_i = −2 a_i b_i + (known numbers). Then K = ``instant`` readings
    with noise σ are worth one reading of −2 a_i b_i with noise σ/√K, wherever the players went. If b had a flat prior,
    x* would be A⁻¹ ξ off its best estimate, ξ ~ N(0, σ²/K), and Anderson's theorem would hold. The prior is uniform on
    intervals of width W: that multiplies P(‖x̂ − x*‖ ≤ r) by at most Π (1 + 2·5 σ/(√K 2 a_i W)), up to 1e-6, and so the
    mean above any d₀ by that factor; d₀ is the 1 % quantile. The mean of log10 ‖x*‖ depends on no policy.

    Infinite for other families of games, and for sensors without additive noise. Own payoffs are measured exactly, so
    there is no such ceiling for a policy that sees them.

    Args:
        world: the world.
        state: the initial state.
        instant: of the measurement, in steps.
    """
    sensor, family, game = world.sensor, world.game_family, state.game
    if not (isinstance(sensor, GradientNoise) and sensor.std > 0 and sensor.relative == 0):
        return np.full(state.step.size, np.inf)
    if not (isinstance(family, RandomEnergy) and isinstance(game, EnergyGame)):
        return np.full(state.step.size, np.inf)
    std, players = sensor.std / np.sqrt(instant), world.game.num_players
    inverse = np.linalg.inv(np.moveaxis(game.jacobian(game.nash_equilibria), 2, 0))
    noise = std * np.random.default_rng(0).normal(size=(players, _SAMPLES))
    digits = _digits_of(np.sqrt(players) * np.linalg.norm(inverse @ noise, axis=1))
    widths = 2 * game.curvature * (family.target[1] - family.target[0])
    edges = np.prod(1 + 2 * _TAIL * std / widths, axis=0)
    start = np.quantile(digits, 0.01, axis=1)
    return start + edges * np.maximum(digits - start[:, None], 0).mean(axis=1) + _scale_digits(state, players)


def news_digits(world: World, state: State, instant: int) -> FloatArray:
    """The ceiling of news that do not arrive, for policies that do not see their own payoff; shape (B,).

    Proof: Where no time-respecting path leads from j to i (:func:`news_steps`), nothing that i sees depends on the
    target b_j. Give the policy everything else: then x* lies on a line, x*(b_j) = const + A⁻¹ e_j 2 a_j b_j, with b_j
    uniform on an interval of width W, and i is at least |b_j − β| ‖A⁻¹ e_j‖ 2 a_j off, for some β that does not depend
    on b_j. The mean of −log10 |b_j − β| is at most −log10(W/2) + 1/ln 10.

    Infinite where all news arrive, whatever the channel loses or delays, and for other families of games.

    Args:
        world: the world.
        state: the initial state.
        instant: of the measurement, in steps.
    """
    family, game = world.game_family, state.game
    missing = ~known_players(world, state, instant)
    if not (missing.any() and isinstance(family, RandomEnergy) and isinstance(game, EnergyGame)):
        return np.full(state.step.size, np.inf)
    inverse = np.linalg.inv(np.moveaxis(game.jacobian(game.nash_equilibria), 2, 0))
    lengths = 2 * game.curvature.T * np.linalg.norm(inverse, axis=1) * (family.target[1] - family.target[0]) / 2
    digits = _digits_of(lengths) + 1 / np.log(10)  # by owner j
    worst = np.where(missing.any(axis=1), digits, np.inf).min(axis=1)
    return worst + _scale_digits(state, world.game.num_players)


def known_players(world: World, state: State, instant: int) -> BoolArray:
    """The players whose gradients a player can have heard of when it decides for the last time before ``instant``.

    Player j reads its gradient at step 0 first, and its estimate of step 1 is the first that can depend on it. News
    travel one live link per step from then on, if the channel neither loses nor delays any.

    Returns:
        By episode, owner of the gradient and hearing player, shape (B, N, N).
    """
    return news_steps(world, state) < instant


def news_steps(world: World, state: State) -> IntArray:
    """The step in which the news of a player's gradient can be heard first; shape (B, N, N), owner before hearer.

    It is 0 for the player itself, and K+H+1 where news never arrive.
    """
    modes, players = _modes(world, state), np.arange(world.game.num_players)
    graphs = np.stack([graph.adjacency > 0 for graph in world.topology.graphs]).astype(np.float32)
    graphs[:, players, players] = 1.0
    steps = np.full((modes.shape[1], players.size, players.size), len(modes), dtype=np.int64)
    steps[:, players, players] = 0
    for step in range(1, len(modes)):
        unknown = steps == len(modes)
        if not unknown.any():
            break
        heard = (~unknown).astype(np.float32) @ graphs[modes[step]] > 0
        steps[unknown & heard] = step
    return steps


def message_bits(channel: Channel) -> float:
    """Bits that a number in a message carries; finitely many numbers of 12 digits need 40 bits each.

    A policy may send any number within ±R = 5e5, and the receivers may add up bits of several steps. Rounding to
    multiples of Δ leaves 2R/Δ + 1 levels, and Gaussian noise of σ the capacity ½ log2(1 + (R/σ)²) of C. E. Shannon, "A
    mathematical theory of communication", 1948. So neither gives a ceiling in an episode of more than a few steps:
    where only honest policies suffer from noise, there is a best known result and no ceiling.
    """
    stages = channel.stages if isinstance(channel, Chain) else (channel,)
    bits = [_FLOAT_BITS]
    for stage in stages:
        if isinstance(stage, UniformQuantiser):
            bits.append(float(np.log2(2 * RANGE_LIMIT / stage.width + 1)))
        elif isinstance(stage, AdditiveNoise) and stage.std > 0:
            bits.append(float(np.log2(1 + (RANGE_LIMIT / stage.std) ** 2)) / 2)
    return min(bits)


def ceiling(
    world: World, state: State, instant: int, *, teammates: Sequence[int] = (), kappa: float = 0.0
) -> dict[str, FloatArray]:
    """The bounds of all policies without an oracle's information, by reason: those that are finite somewhere.

    :func:`sensor_digits` and :func:`news_digits` are not among them: they hold of policies without own payoff only.

    Args:
        world: the world.
        state: the initial state of the episodes.
        instant: of the measurement, in steps.
        teammates: players that follow the static law.
        kappa: κ of the teammates.

    Raises:
        ValueError: when κ is negative.
    """
    bounds = {
        "reach": reach_digits(world, state, instant),
        "pushes": push_digits(world, state, instant),
    }
    if teammates:
        gain = require_non_negative("kappa", kappa)
        bounds["teammates"] = teammate_digits(world, state, instant, teammates, gain)
    return {name: digits for name, digits in bounds.items() if np.isfinite(digits).any()}


def _modes(world: World, state: State) -> IntArray:
    """The active graph at each instant of each episode, shape (K+H+1, B)."""
    if state.randomness is not None and state.randomness.modes is not None:
        return state.randomness.modes.astype(np.int64)
    return np.repeat(world.modes[:, None], state.step.size, axis=1)


def _scale_digits(state: State, players: int) -> FloatArray:
    """log10(√N ‖x*‖), by which digits of absolute distances become those of relative ones; shape (B,)."""
    return np.broadcast_to(np.log10(np.sqrt(players) * state.game.equilibrium_scale), state.step.shape)


def _digits_of(distance: FloatArray) -> FloatArray:
    """−log10 of absolute distances, infinite at 0; any shape."""
    with np.errstate(divide="ignore"):
        return -np.log10(distance)
