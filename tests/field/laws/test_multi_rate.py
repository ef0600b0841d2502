"""The multi-rate law: roles, its linear loop, and games with coupled constraints."""

import numpy as np
import pytest
from affine_games import SOAK, loop_start, run
from sample_laws import condition_on
from worlds import fixed_part

from ptne_env import FactorySpec, evaluate, get_scenario, theory
from ptne_env.evaluation import POLICIES
from ptne_env.field import laws as field_laws
from ptne_env.field.games import priced
from ptne_env.games import EnergyGame
from ptne_env.perception.encoder import make_encoder
from ptne_env.world.world import World

TRANSFORMED = get_scenario("random-energy-switching-transformed").topology


def of_games(name, **arguments):
    return FactorySpec.of(f"ptne_env.games:{name}", **arguments)


def coupled(players=5, lines=2, **fields):
    """Random energy games with shared constraints, on a cycle."""
    game = of_games("CoupledConstraint", game=of_games("RandomEnergy", players=players), lines=lines)
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


def memories(scenario, steps=3, **arguments):
    """The memory of every player after the first steps."""
    world = World(scenario)
    encoder = make_encoder(world, field_laws.MultiRate.interface)
    law = field_laws.MultiRate(encoder.layout, **arguments)
    found = []

    class Recording:
        def predict(self, observations, state=None):
            actions, memory = law.predict(observations, state=state)
            found.append(law._parts.split(memory))
            return actions, memory

    states = run(world, encoder, Recording(), loop_start(world, size=5.0), steps)
    return found, states


def test_players_learn_who_prices_the_constraint():
    found, states = memories(SHARED)
    assert found[2]["is_price"][:, 0].tolist() == [0, 0, 0, 0, 0, 1]
    others = ~np.eye(6, dtype=bool)
    assert np.array_equal(states[0][others], states[2][others])  # copies rest during the probes


@pytest.mark.parametrize("name", ["cournot", "ev-charging", "robots", "energy", "rate-control"])
def test_games_without_operator_have_players_only(name):
    found, _ = memories(get_scenario(name, start="random"))
    assert not found[2]["is_price"].any()


def test_a_small_input_limit_hides_no_role():
    found, _ = memories(SHARED.replace(input_limit=5.0))
    assert found[2]["is_price"][:, 0].tolist() == [0, 0, 0, 0, 0, 1]


def test_after_its_probes_it_plays_as_routed_where_nobody_prices():
    world = World(get_scenario("robots"))
    encoder = make_encoder(world, field_laws.MultiRate.interface)
    law, routed = field_laws.MultiRate(encoder.layout, step=0.3), field_laws.Routed(encoder.layout, step=0.3)
    states = run(world, encoder, law, loop_start(world), steps=12)
    start = loop_start(world)._replace(estimates=states[2])
    start = start._replace(own_gradients=world.game.own_gradients(states[2]), step=np.array([2]))
    expected = run(world, encoder, routed, start, steps=10)
    np.testing.assert_allclose(states[2:], expected, rtol=1e-5, atol=1e-5)


def test_prices_follow_the_proportional_and_integral_feedback():
    found, states = memories(SHARED, steps=60, step=0.1, price_step=0.05, lead=3.0)
    prices, gradients = states[-20:, 5, 5, 0], np.array([memory["gradient"][5, 5] for memory in found[-20:]])
    assert (prices > 0).all()  # no bound held them
    expected = -0.05 * (gradients[1:] + 3.0 * np.diff(gradients))
    assert np.diff(prices) == pytest.approx(expected, rel=1e-4, abs=1e-5)


def test_the_loop_decides_where_the_law_settles():
    for price_step, settles in ((0.05, True), (1.3, False)):
        condition = condition_on(SHARED, field_laws.MultiRate, price_step=price_step)
        assert condition.holds is settles
        policy = FactorySpec.of("ptne_env.field.laws:MultiRate", price_step=price_step)
        world = World(SHARED)
        encoder = make_encoder(world, field_laws.MultiRate.interface)
        states = run(world, encoder, policy.build(layout=encoder.layout), loop_start(world))[..., 0]
        errors = np.linalg.norm(states - world.game.nash_equilibrium[:, None], axis=(1, 2))
        assert bool(errors[-1] < 1e-5 * errors[0]) is settles
        if settles:  # and how fast, until messages of float32 end the decay
            assert (errors[60] / errors[20]) ** (1 / 40) == pytest.approx(condition.value, rel=0.03)


def test_loop_takes_the_steps_of_its_recursion():
    generator = np.random.default_rng(1)
    jacobian, delays = generator.normal(size=(3, 3)) + 2 * np.eye(3), generator.integers(0, 3, (3, 3))
    steps, leads = np.array([0.1, 0.1, 0.05]), np.array([0.0, 0.0, 2.0])
    errors = list(generator.normal(size=(4, 3)))
    for _ in range(400):
        now, before = (
            np.array([sum(jacobian[c, b] * errors[-1 - lag - delays[c, b]][b] for b in range(3)) for c in range(3)])
            for lag in (0, 1)
        )
        errors.append(errors[-1] - steps * (now + leads * (now - before)))
    rate = np.linalg.norm(errors[-100:-50]) / np.linalg.norm(errors[-50:])
    expected = theory.multi_rate_radius(jacobian, delays, steps, leads)
    assert rate ** (-1 / 50) == pytest.approx(expected, rel=0.02)


def test_switching_graphs_have_no_theorem():
    assert not condition_on("energy-switching", field_laws.MultiRate).holds


@pytest.mark.parametrize(
    ("scenario", "digits"),
    [(coupled(), 10.5), (coupled(players=4, lines=1, topology=TRANSFORMED, name="switching"), 3.0)],
    ids=["cycle", "switching"],
)
def test_coupled_constraints_are_met_to_many_digits(scenario, digits):
    names = ["static", "grounded", "routed", "multi-rate"]
    results = evaluate(names, [scenario], episodes=300 if SOAK else 40, seed=87235, against_laws=False)
    reached = {name: results.samples[scenario.name, name]["digits"].mean() for name in names}
    assert reached["multi-rate"] > digits
    assert max(reached, key=reached.get) == "multi-rate"


def test_estimates_are_honest_and_hop_counts_are_declared():
    assert POLICIES["multi-rate"].interface.estimates == "honest"
    assert POLICIES["multi-rate"].interface.graph_knowledge == "union"


@pytest.mark.parametrize("arguments", [{"step": 0.0}, {"price_step": -1.0}, {"lead": -0.1}])
def test_wrong_numbers_are_named(arguments):
    layout = make_encoder(World(get_scenario("energy")), field_laws.MultiRate.interface).layout
    with pytest.raises(ValueError, match=f"{next(iter(arguments))} must be"):
        field_laws.MultiRate(layout, **arguments)
