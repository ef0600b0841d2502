"""The fixed-time law: the solution of its equation, its times to settle, and steps that do not overshoot."""

import numpy as np
import pytest
from affine_games import affine_scenario, loop_start, run
from worlds import fixed_part, world_and_encoder

from ptne_env import FactorySpec, laws
from ptne_env.world import dynamics

COMPLETE = fixed_part(np.ones((3, 3)) - np.eye(3))


def separable(curvatures, offset=(1.0, -2.0, 0.5), **fields):
    """Players whose own gradients μ_i (x_i − x*_i) depend on no other player, on a complete graph."""
    scenario = affine_scenario(np.diag(curvatures), offset, COMPLETE, **{"input_limit": 1e14, **fields})
    return world_and_encoder(scenario)


def effective_times(world):
    """τ before each step, and at the end."""
    return np.concatenate([[0.0], np.cumsum(world.clock.theta[: world.clock.steps])])


def test_gradients_follow_the_solution_of_the_scalar_equation():
    """|g|^α = tan(arctan |g(0)|^α − α μ τ) solves dg/dτ = −μ (|g|^{1−α} + |g|^{1+α}) sign(g)."""
    world, encoder = separable((1.0, 1.0, 1.0), steps=2000)
    law = laws.FixedTime(encoder.layout, kappa=1.0, power=0.5, step=1.0)
    states = run(world, encoder, law, loop_start(world, size=10.0))[..., 0]
    gradients = np.abs(np.einsum("kii->ki", states) - world.game.nash_equilibrium)
    times = effective_times(world)
    phases = np.arctan(gradients[0] ** 0.5) - 0.5 * times[:, None]
    exact = np.where(phases > 0, np.tan(np.maximum(phases, 0.0)) ** 2, 0.0)
    assert phases[-1].max() < 0
    assert gradients == pytest.approx(exact, abs=0.01 * gradients[0].max())


def test_estimates_follow_signed_powers_of_consensus_errors():
    world, encoder = separable((1.0, 1.0, 1.0), steps=2000)
    states = run(world, encoder, laws.FixedTime(encoder.layout, kappa=3.0, power=0.25), loop_start(world), 6)[..., 0]
    now = states[:-1]
    errors = 3 * now - now.sum(axis=2, keepdims=True) + now - np.einsum("kii->ki", now)[..., None]  # ξ^i_j at [:, j, i]
    expected = -3.0 * np.sign(errors) * (np.abs(errors) ** 0.75 + np.abs(errors) ** 1.25)
    others = ~np.eye(3, dtype=bool)
    moves = (states[1:] - now) / world.clock.theta[:6, None, None]
    assert moves[:, others] == pytest.approx(expected[:, others], rel=1e-4)


@pytest.mark.parametrize("size", [1.0, 1e3, 1e5])
def test_time_to_settle_does_not_depend_on_the_start(size):
    world, encoder = separable((2.0, 2.0, 2.0), steps=1000)
    law = laws.FixedTime(encoder.layout, kappa=2.0, power=0.5, step=0.5)
    start = loop_start(world, size=size)
    errors = np.abs(run(world, encoder, law, start)[..., 0] - world.game.nash_equilibrium[:, None])
    times = effective_times(world)
    strategies = np.pi / (2 * 0.5 * 2.0)  # each of them is a potential game of one component, μ = 2
    estimates = np.pi * 2 ** (0.5 / 4) / (2 * 0.5 * 2.0 * 2.0)  # λ = 2: H_j = [[3, −1], [−1, 3]]
    assert strategies + estimates < times[-1]
    assert np.einsum("kii->ki", errors)[times >= strategies].max() < 1e-3
    assert errors[times >= strategies + estimates].max() < 1e-3
    linear = run(world, encoder, laws.Grounded(encoder.layout, kappa=2.0), start)[..., 0]
    late = np.abs(linear[times >= strategies + estimates][0] - world.game.nash_equilibrium[:, None]).max()
    assert late > 1e-3 * size  # the linear law forgets a share of the start


def test_no_step_overshoots_however_long_it_is():
    """Strategies do not pass x*, and estimates stay between those of the neighbours, where η ≤ 1/μ_i."""
    world, encoder = separable((0.5, 2.0, 4.0), steps=12, s_end=30.0)
    law = laws.FixedTime(encoder.layout, kappa=50.0, power=0.9, step=0.25)
    states = run(world, encoder, law, loop_start(world, size=1e3))[..., 0]
    assert world.clock.theta[:12].min() > 1
    errors = np.einsum("kii->ki", states) - world.game.nash_equilibrium
    rounding = 1e-6 * np.abs(states[:-1]).max(axis=(1, 2))
    assert np.all(errors[1:] * np.sign(errors[0]) >= -rounding[:, None])
    assert np.all(np.abs(errors[1:]) <= np.abs(errors[:-1]) + rounding[:, None])
    highest, lowest = states.max(axis=2), states.min(axis=2)
    assert np.all(highest[1:] <= np.maximum(highest[:-1], world.game.nash_equilibrium) + rounding[:, None])
    assert np.all(lowest[1:] >= np.minimum(lowest[:-1], world.game.nash_equilibrium) - rounding[:, None])


@pytest.mark.parametrize("input_limit", [1e14, 10.0])
def test_steps_shorten_to_the_curvature_that_was_seen(input_limit):
    """With η = 1 and μ = 100 gradient steps would grow 99 times each. The limit shortens moves, too."""
    world, encoder = separable((100.0, 100.0, 100.0), steps=50, input_limit=input_limit)
    law, memory = laws.FixedTime(encoder.layout, step=1.0), None
    start = dynamics.initial_state(world, np.full((3, 3, 1), 20.0))
    for estimates in run(world, encoder, law, start, steps=1):
        state = dynamics.initial_state(world, estimates)
        _, memory = law.predict(encoder.observe(state)[0], state=memory)
    assert memory.largest == pytest.approx(100.0, rel=1e-3)
    states = run(world, encoder, law, start)[..., 0]
    assert np.abs(states[-1] - world.game.nash_equilibrium[:, None]).max() < 1e-4


def test_players_rest_at_the_equilibrium_at_zero():
    start = FactorySpec.of("start:fixed", estimates=np.zeros((3, 3)).tolist())
    world, encoder = separable((1.0, 2.0, 4.0), (0.0, 0.0, 0.0), start=start, steps=10)
    assert not run(world, encoder, laws.FixedTime(encoder.layout), loop_start(world, size=0.0)).any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kappa": 0.0}, "kappa must be a finite number above 0"),
        ({"step": -1.0}, "step must be a finite number above 0"),
        ({"power": 0.0}, "power must be a finite number above 0"),
        ({"power": 1.1}, "power must be at most 1"),
    ],
)
def test_parameters_out_of_range_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        laws.FixedTime(world_and_encoder("energy")[1].layout, **arguments)
