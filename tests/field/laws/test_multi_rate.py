"""The multi-rate law: roles, its feedback, and games with coupled constraints."""

import numpy as np
import pytest
from affine_games import SOAK, loop_start, run
from worlds import fixed_part, world_and_encoder

from ptne_env import FactorySpec, evaluate, get_scenario
from ptne_env.field import laws as field_laws
from ptne_env.field.games import priced
from ptne_env.games import EnergyGame

TRANSFORMED = get_scenario("random-energy-switching-transformed").topology


def coupled(players=5, lines=2, **fields):
    """Random energy games with shared constraints, on a cycle."""
    game = FactorySpec.of(
        "ptne_env.field.games:CoupledConstraint",
        game=FactorySpec.of("game:random-energy", players=players),
        lines=lines,
    )
    cycle = np.roll(np.eye(players + 1), 1, axis=0)
    return get_scenario(
        "random-energy", **{"name": "coupled", "game": game, "topology": fixed_part(cycle + cycle.T)} | fields
    )


def shared_load(limit=40.0):
    """The energy game with the shared constraint Σ x_i ≤ limit."""
    return priced(EnergyGame(), np.ones((1, 5)), [limit])


SHARED = get_scenario(
    "energy",
    name="shared",
    game=FactorySpec.of("test_multi_rate:shared_load"),
    start="random",
    topology=fixed_part(np.ones((6, 6)) - np.eye(6)),
)


def played(scenario, steps, **arguments):
    """The world, all estimates (K+1, n, N), and all inputs (K, N, n)."""
    world, encoder = world_and_encoder(scenario)
    law, inputs = field_laws.MultiRate(encoder.layout, **arguments), []

    class Recording:
        def predict(self, observations, state=None):
            actions, memory = law.predict(observations, state=state)
            inputs.append(actions)
            return actions, memory

    states = run(world, encoder, Recording(), loop_start(world, size=5.0), steps)
    return world, states[..., 0], np.array(inputs)


def test_copies_rest_during_the_two_probes_which_cancel():
    _, states, _ = played(SHARED, 3)
    others, players = ~np.eye(6, dtype=bool), range(5)
    assert np.array_equal(states[0][others], states[2][others])
    np.testing.assert_allclose(states[0, players, players], states[2, players, players], atol=1e-5)
    assert np.abs(states[1] - states[0]).max() > 0.1


@pytest.mark.parametrize("input_limit", [1000.0, 5.0])
def test_prices_follow_the_proportional_and_integral_feedback(input_limit):
    """Player 5 prices the constraint, and the others do not: a small input limit hides no role."""
    scenario = SHARED.replace(input_limit=input_limit)
    world, states, _ = played(scenario, 80, step=0.1, price_step=0.05, lead=3.0)
    prices = states[-20:, 5, 5]
    assert (prices > 0).all()  # no bound held them
    gradients = np.array([world.game.own_gradients(state[:, :, None])[:, 0] for state in states[-20:]])
    expected = -0.05 * (gradients[1:-1, 5] + 3.0 * np.diff(gradients[:-1, 5]))
    assert np.diff(prices)[1:] == pytest.approx(expected, rel=1e-3, abs=1e-5)
    own = states[-20:, range(5), range(5)]
    assert np.diff(own, axis=0) == pytest.approx(-0.1 * gradients[:-1, :5], rel=1e-3, abs=1e-5)


@pytest.mark.parametrize("name", ["cournot", "robots", "rate-control"])
def test_where_nobody_prices_it_plays_as_routed_after_its_probes(name):
    """Routed play forgets the copies that it had at its start, so that both descend with the same delays."""
    scenario = get_scenario(name, start="random", steps=60)
    world, states, inputs = played(scenario, 40, step=0.3)
    for k in (20, 33):
        gradients = world.game.own_gradients(states[k][:, :, None])[:, 0]
        moved = inputs[k][world.game.owners, range(world.game.dimension)] * world.clock.theta[k]
        reach = scenario.input_limit * world.clock.theta[k]
        assert moved == pytest.approx(np.clip(-0.3 * gradients, -reach, reach), rel=1e-3, abs=1e-4)


@pytest.mark.parametrize(("price_step", "settles"), [(0.05, True), (1.3, False)])
def test_small_steps_settle_at_the_equilibrium_with_prices(price_step, settles):
    world, states, _ = played(SHARED, 400, price_step=price_step)
    errors = np.linalg.norm(states - world.game.nash_equilibrium[:, None], axis=(1, 2))
    assert bool(errors[-1] < 1e-5 * errors[0]) is settles


@pytest.mark.parametrize(
    ("scenario", "digits"),
    [(coupled(), 10), (coupled(players=4, lines=1, topology=TRANSFORMED, name="switching"), 2.5)],
    ids=["cycle", "switching"],
)
def test_coupled_constraints_are_met_to_many_digits(scenario, digits):
    names = ["static", "grounded", "routed-unknown", "multi-rate"]
    results = evaluate(names, [scenario], episodes=300 if SOAK else 6, seed=87235)
    reached = {name: results.samples[scenario.name, name]["digits"].mean() for name in names}
    assert reached["multi-rate"] > digits
    assert max(reached, key=reached.get) == "multi-rate"


@pytest.mark.parametrize("arguments", [{"step": 0.0}, {"price_step": -1.0}, {"lead": -0.1}])
def test_wrong_numbers_are_named(arguments):
    layout = world_and_encoder("energy")[1].layout
    with pytest.raises(ValueError, match=f"{next(iter(arguments))} must be"):
        field_laws.MultiRate(layout, **arguments)
