"""The contact relay: best responses, its convergence with every kind of player and message, and its caution."""

import numpy as np
import pytest
from affine_games import loop_start, run
from worlds import BLOCKS, BLOCKS_SWITCHING, channel_part, world_and_encoder

from ptne_env import evaluate, get_scenario, laws
from ptne_env.laws.building_blocks.own_gradient import Model, best_response

RANDOM = get_scenario("random-energy")


def response(rows, gradient, drift, held=False, radius=1e6, covariance=None, is_fixed=False):
    """Displacement of a player whose m own components come first, and who knows its rows."""
    rows = np.asarray(rows, dtype=float)[None]
    m, size = rows.shape[1:]
    model = Model(rows, np.zeros((1, size, size)) if covariance is None else covariance[None])
    places, is_held = np.arange(m)[None], np.broadcast_to(held, (1, m))
    arrays = np.array(gradient, dtype=float)[None], np.array(drift, dtype=float)[None]
    return best_response(model, *arrays, places, is_held, np.full((1, 1), radius), np.full((1, 1), is_fixed))[0]


def test_best_response_zeroes_the_own_gradient_at_the_next_estimates():
    rows = [[3.0, 0.5, 0.2, -0.4], [0.5, 2.0, 0.1, 0.3]]
    gradient, drift = [1.0, -4.0], [0.0, 0.0, 2.0, -1.0]
    step = response(rows, gradient, drift)
    assert gradient + np.array(rows) @ [*step, 2.0, -1.0] == pytest.approx([0, 0], abs=1e-12)


@pytest.mark.parametrize(
    ("rows", "gradient", "arguments", "expected"),
    [
        ([[1.0, 2.0, -2.0]], [4.0], {}, [-1.0]),  # damped: the row sum beside the diagonal is 4
        ([[-2.0, 0.0]], [4.0], {}, [-2.0]),  # a negative curvature gives a gradient step
        ([[-2.0, 0.0]], [4.0], {"is_fixed": True, "radius": 3.0}, [-3.0]),  # or one as long as the trust region
        ([[0.0, 0.0]], [6.0], {"covariance": 100.0 * np.eye(2)}, [-6 / 30]),  # and an unknown one a short step
        ([[1.0, 0.0], [0.0, 1.0]], [4.0, -2.0], {"radius": 1.0}, [-1.0, 0.5]),  # the trust region shortens
        ([[2.0, 1.0], [1.0, 2.0]], [-2.0, 1.0], {"held": [True, False]}, [1.0, -0.5]),  # as if the held one stayed
    ],
)
def test_best_response_is_cautious(rows, gradient, arguments, expected):
    assert response(rows, gradient, [0.0] * len(rows[0]), **arguments) == pytest.approx(expected)


@pytest.mark.parametrize("scenario", [BLOCKS, BLOCKS_SWITCHING], ids=lambda scenario: scenario.name)
@pytest.mark.parametrize("law", [laws.ContactRelay, laws.ObserverRelay])
def test_players_of_unequal_dimensions_reach_the_equilibrium(law, scenario):
    world, encoder = world_and_encoder(scenario)
    states = run(world, encoder, law(encoder.layout), loop_start(world))[..., 0]
    assert np.abs(states[-1] - world.game.nash_equilibrium[:, None]).max() < 1e-8


def test_relay_reaches_many_digits_in_games_and_with_messages_of_all_kinds():
    """Several components at a bound, curvature far from 1, costs that are not quadratic, and late messages."""
    late = RANDOM.replace(name="late", channel=channel_part("Delay", steps=1, longest=7))
    names = ["random-energy", "ev-charging", "cournot", "oligopoly", "non-quadratic", late]
    results = evaluate(["contact-relay"], names, episodes=3)
    assert len(results.samples) == len(names)
    for samples in results.samples.values():
        assert np.median(samples["digits"]) > 10


def test_noise_is_averaged():
    noisy = RANDOM.replace(name="noisy", channel=channel_part("AdditiveNoise", std=0.05))
    results = evaluate(["contact-relay", "grounded"], [noisy], episodes=10)
    relay, plain = (results.samples["noisy", name]["digits"].mean() for name in ("contact-relay", "grounded"))
    assert relay > plain + 0.3


@pytest.mark.parametrize("name", ["patience", "forgetting"])
def test_wrong_numbers_are_named(name):
    with pytest.raises(ValueError, match=f"{name} must be a finite number above 0"):
        laws.ContactRelay(world_and_encoder("energy")[1].layout, **{name: 0.0})
