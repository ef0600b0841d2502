"""A law acts on its player's information: with the rest of the world scrambled, every action keeps its bits.

And relabelling the players permutes the results: no law prefers a player for its number.
"""

from functools import partial

import numpy as np
import pytest
from affine_games import SOAK
from worlds import begin, energy_scenario, every_field, fixed_part, make_env, play, world_and_encoder

from ptne_env import FactorySpec, laws
from ptne_env.laws import Coded, Relay
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.fields import FIELDS
from ptne_env.shared.parts import PARTS, resolve
from ptne_env.world import dynamics

LAWS = {part: law for part in PARTS if part.startswith("law:") and issubclass(law := resolve(part), laws.Law)}
del LAWS["law:oracle"]  # the only one that may read what its player cannot know
RELATIVE = [part for part, law in LAWS.items() if "own_estimate" not in law.needs]
"""Laws that need no absolute strategies, so that they also act through the interface ``scaled``."""
LAWS["law:coded"] = partial(Coded, policy=Relay)
CASES = [*((law, "physical") for law in LAWS), *((law, "scaled") for law in RELATIVE)]
STEPS = 150 if SOAK else 50

RING = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0)]
MODES = [[(0, 1), (2, 3)], [(1, 2), (3, 4)], [(2, 3), (4, 0)], [(3, 4), (0, 1)]]
CURVATURE = np.array([1.0, 1.3, 0.8, 1.1, 0.9])
TARGET = np.array([10.0, 15.0, 20.0, 25.0, 30.0])


def topology_spec(modes, weights):
    """A topology with these links and a weight for each pair."""
    graphs = []
    for edges in modes:
        adjacency = np.zeros((5, 5))
        for i, j in edges:
            adjacency[i, j] = adjacency[j, i] = weights[min(i, j), max(i, j)]
        graphs.append(FactorySpec.of("ptne_env.world.graphs:Graph", adjacency=adjacency))
    if len(graphs) == 1:
        return graphs[0]
    return FactorySpec.of("topology:periodic", graphs=graphs, dwells=[0.1] * len(graphs), clock="physical")


def scrambled_scenario(player, modes, weights, generator):
    """Other costs for the others, and other links wherever ``player`` has none; its own links keep their weights."""
    others = [j for j in range(5) if j != player]
    strangers = [j for j in others if (min(j, player), max(j, player)) not in {tuple(sorted(edge)) for edge in RING}]
    swap = dict(zip(strangers, reversed(strangers), strict=True))
    swapped = [
        [edge if player in edge else tuple(swap.get(end, end) for end in edge) for edge in edges] for edges in modes
    ]
    other_weights = weights * generator.uniform(0.5, 1.5, weights.shape)
    for j in others:
        pair = min(j, player), max(j, player)
        other_weights[pair] = weights[pair]
    curvature, target = CURVATURE.copy(), TARGET.copy()
    curvature[others] = generator.uniform(0.5, 2, 4)
    target[others] = generator.uniform(-30, 30, 4)
    return energy_scenario(curvature, target, topology_spec(swapped, other_weights))


@pytest.mark.parametrize("modes", [[RING], MODES], ids=["fixed", "switching"])
@pytest.mark.parametrize(("law", "kind"), CASES)
@pytest.mark.parametrize("player", range(5) if SOAK else [3])
def test_scrambling_hidden_information_changes_no_action(player, law, kind, modes):
    generator = np.random.default_rng(player)
    weights = generator.uniform(0.5, 1.5, (5, 5))
    world, encoder = world_and_encoder(energy_scenario(CURVATURE, TARGET, topology_spec(modes, weights)), kind=kind)
    other, other_encoder = world_and_encoder(scrambled_scenario(player, modes, weights, generator), kind=kind)
    assert np.abs(other.game.nash_equilibrium - world.game.nash_equilibrium).max() > 1
    assert not np.array_equal(other.mode_weights, world.mode_weights)

    policy, other_policy = LAWS[law](encoder.layout), LAWS[law](other_encoder.layout)
    memory = other_memory = None
    state = dynamics.initial_state(world, generator.uniform(-20, 20, (5, 5, 1)))
    for _ in range(STEPS):
        links = dynamics.weights(world, state)[:, player, 0] > 0
        visible = [player, *world.neighbours[:, player][links]]
        estimates = generator.uniform(-20, 20, (5, 5, 1))
        estimates[:, visible] = state.estimates[:, visible]
        other_state = dynamics.initial_state(other, estimates)._replace(step=state.step)

        observations, other_observations = encoder.observe(state)[0], other_encoder.observe(other_state)[0]
        actions, memory = policy.predict(observations, state=memory)
        other_actions, other_memory = other_policy.predict(other_observations, state=other_memory)
        assert np.array_equal(actions[player], other_actions[player])
        strangers = [j for j in range(5) if j not in visible]
        assert not np.array_equal(observations[strangers], other_observations[strangers])
        state = dynamics.step(world, state, encoder.decode(actions[None], state))


@pytest.mark.parametrize("modes", [[RING], MODES], ids=["fixed", "switching"])
@pytest.mark.parametrize(
    ("name", "interface"), [case for case in every_field() if not FIELDS[case.values[0]].is_privileged]
)
def test_scrambling_hidden_information_changes_no_field(name, interface, modes):
    """Unless the field is privileged, that is."""
    player, generator = 3, np.random.default_rng(3)
    weights = generator.uniform(0.5, 1.5, (5, 5))
    world, encoder = world_and_encoder(energy_scenario(CURVATURE, TARGET, topology_spec(modes, weights)), interface)
    other, twin = world_and_encoder(scrambled_scenario(player, modes, weights, generator), interface)
    for step in (0, 60, 130):
        estimates, others = generator.uniform(-20, 20, (2, 5, 5, 1))
        state = dynamics.initial_state(world, estimates)._replace(step=np.array([step]))
        visible = [player, *world.neighbours[:, player][dynamics.weights(world, state)[:, player, 0] > 0]]
        others[:, visible] = estimates[:, visible]
        scrambled = dynamics.initial_state(other, others)._replace(step=state.step)
        seen = encoder.layout.select(encoder.observe(state), name)[0, player]
        assert np.array_equal(seen, twin.layout.select(twin.observe(scrambled), name)[0, player])


@pytest.mark.parametrize(("law", "kind"), CASES)
def test_relabelling_the_players_permutes_the_results(law, kind):
    adjacency = np.zeros((5, 5))  # a tree with a triangle and unequal weights: no symmetry
    for (i, j), weight in {(0, 1): 1.0, (1, 2): 0.7, (0, 2): 1.2, (2, 3): 0.9, (3, 4): 1.1}.items():
        adjacency[i, j] = adjacency[j, i] = weight
    new = np.array([3, 0, 4, 1, 2])  # player i is called new[i]
    old = np.argsort(new)
    generator = np.random.default_rng(0)
    start = generator.uniform(-5, 5, (5, 5))  # near enough for the action box of ``scaled``

    def run(order):
        topology = fixed_part(adjacency[np.ix_(order, order)])
        scenario = energy_scenario(CURVATURE[order], TARGET[order] / 5, topology, steps=120, gain=4.0, s_end=4.7)
        env = make_env(scenario, interface=kind)
        return play(env, LAWS[law](env.layout), options={"estimates": start[np.ix_(order, order)]})[0]

    plain, relabelled = run(np.arange(5)), run(old)
    assert np.abs(relabelled[:, new][:, :, new] - plain).max() <= 1e-6 * np.abs(plain).max()
    if law != "zero-input":
        assert np.abs(relabelled - plain).max() > 1  # the labels do matter to the arrays


@pytest.mark.parametrize("law", RELATIVE)
def test_a_law_says_the_same_through_both_interfaces(law):
    """Its inputs have the unit of the observation, also where gains grow with squares of natural units."""
    world, physical = world_and_encoder("energy")
    views = [(encoder, LAWS[law](encoder.layout)) for encoder in (physical, Encoder(world, "scaled"))]
    state, memories = begin(world, [0]), [law.initial_memory(5) for _, law in views]
    for _ in range(10):
        inputs = []
        for index, (encoder, policy) in enumerate(views):
            observation = encoder.layout.read(encoder.observe(state)[0])
            answer, memories[index] = policy.inputs(observation, memories[index])
            inputs.append(answer * observation.unit)
        np.testing.assert_allclose(inputs[1], inputs[0], rtol=1e-4, atol=1e-4 * np.abs(inputs[0]).max())
        state = dynamics.step(world, state, inputs[0].T[:, :, None] / 5)
