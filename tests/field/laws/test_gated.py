"""Gated laws: the displacement that gates mix, the last step, odd worlds, and what observers gain over contacts."""

import numpy as np
import pytest
from affine_games import affine_scenario, loop_start, random_affine, run
from sample_laws import spec_of
from worlds import BLOCKS, BLOCKS_SWITCHING, FAULTY, begin, fixed_part, world_and_encoder

from ptne_env import FactorySpec, Scenario, get_scenario
from ptne_env.evaluation import POLICIES, Suite, Track, get_suite, run_suite
from ptne_env.evaluation.suite import Teammates
from ptne_env.field import laws as field_laws
from ptne_env.field.laws.averages import dither
from ptne_env.field.laws.gated import CellGates, GatedLaw, ObserverRelay, SlotGates
from ptne_env.laws import gated, relay
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import Interface, LayoutError
from ptne_env.world import dynamics
from ptne_env.world.world import World

RANDOM = get_scenario("random-energy")


def episode(scenario, law, steps=None, batch=1):
    """All estimates of an episode from the scenario's own starts, (K+1, n, N, B), and the world."""
    world, encoder = world_and_encoder(scenario)
    return run(world, encoder, law(encoder.layout), begin(world, range(batch)), steps), world


# --- the last step --------------------------------------------------------------------------------------------------


class Watched(ObserverRelay):
    """Keeps the evidence of every step."""

    def __init__(self, layout):
        super().__init__(layout)
        self.seen = []

    def gates(self, cells, slots):
        self.seen.append((cells, slots))
        return super().gates(cells, slots)


def closing(scenario):
    """Whether each player takes each step for one of the last, (K+H, N), and whether its clock says so."""
    world, encoder = world_and_encoder(scenario)
    law, steps = Watched(encoder.layout), world.clock.total_steps
    run(world, encoder, law, begin(world, [0]), steps)
    left = (encoder.layout.largest_clock[1] - encoder.clock_table[1].astype(float)).T  # in s, at every instant
    found = np.array([cells.closing[:, 0] > 0 for cells, _ in law.seen[:steps]])
    return found, np.broadcast_to((left[:-1] <= 1) | (left[1:] < 1e-5), found.shape)


@pytest.mark.filterwarnings("ignore:.*short of the deadline")  # λ of the rational transformation is slow
@pytest.mark.parametrize("hold_steps", [0, 3])
@pytest.mark.parametrize("transformation", ["exponential", "rational", "tanh"])
@pytest.mark.parametrize("spacing", ["effective", "transformed", "physical"])
@pytest.mark.parametrize("steps", [2, 25])
def test_the_end_is_known_within_one_in_s_and_in_the_last_step(steps, spacing, transformation, hold_steps):
    times = {"steps": steps, "spacing": spacing, "transformation": transformation, "hold_steps": hold_steps}
    found, is_near = closing(RANDOM.replace(**times))
    np.testing.assert_array_equal(found, is_near)
    assert found[steps - 1 :].all()
    assert not found[0].any()


def test_each_player_knows_the_end_by_its_own_clock():
    found, is_near = closing(RANDOM.replace(steps=50, clock_shifts=(0.0, 0.1, -0.1, 0.0, 0.0)))
    np.testing.assert_array_equal(found, is_near)
    right, fast, slow = found[:, [0, 3, 4]].sum(axis=0), found[:, 1].sum(), found[:, 2].sum()
    assert slow < right.min() == right.max() < fast


# --- memory and odd worlds ------------------------------------------------------------------------------------------


def test_rows_whose_episode_starts_forget_and_all_others_remember():
    world, encoder = world_and_encoder(FAULTY)
    law, memory, state = ObserverRelay(encoder.layout), None, begin(world, [0])
    for _ in range(30):
        observations = encoder.observe(state)[0]
        actions, memory = law.predict(observations, state=memory)
        state = dynamics.step(world, state, encoder.decode(actions[None], state))
    observations, starts = encoder.observe(state)[0], np.array([True, False, True, False, False])
    mixed, mixed_memory = law.predict(observations, state=memory, episode_start=starts)
    going, going_memory = law.predict(observations, state=memory)
    fresh, fresh_memory = law.predict(observations)
    assert np.array_equal(mixed, np.where(starts[:, None], fresh, going))
    assert np.array_equal(mixed_memory, np.where(starts[:, None], fresh_memory, going_memory))
    assert not np.array_equal(going, fresh)


@pytest.mark.parametrize("scenario", [BLOCKS, BLOCKS_SWITCHING], ids=lambda scenario: scenario.name)
def test_players_of_unequal_dimensions_find_the_equilibrium(scenario):
    world, encoder = world_and_encoder(scenario)
    states = run(world, encoder, ObserverRelay(encoder.layout), loop_start(world))[..., 0]
    assert np.abs(states[-1] - world.game.nash_equilibrium[:, None]).max() < 1e-8


def test_a_single_row_is_decided_as_in_the_batch():
    """From a layout that hides the links of all others."""
    world, encoder = world_and_encoder(RANDOM)
    observation = encoder.observe(begin(world, [0]))[0]
    action, memory = ObserverRelay(encoder.layout.known_to(2)).predict(observation[2])
    batch, memories = ObserverRelay(encoder.layout).predict(observation)
    np.testing.assert_array_equal(action, batch[2])
    np.testing.assert_array_equal(np.ravel(memory), memories[2])


@pytest.mark.parametrize("scenario", [BLOCKS, FAULTY], ids=lambda scenario: scenario.name)
def test_own_blocks_are_enough_in_large_games(scenario, monkeypatch):
    for module in (relay, gated):
        monkeypatch.setattr(module, "LARGEST_ROW", 1)
    states, world = episode(scenario, ObserverRelay)
    assert np.isfinite(states).all()
    if scenario is BLOCKS:
        assert np.abs(states[-1, ..., 0] - world.game.nash_equilibrium[:, None]).max() < 1e-8
    _, encoder = world_and_encoder(scenario)
    assert "planes" not in ObserverRelay(encoder.layout)._parts.split(ObserverRelay(encoder.layout).initial_memory(1))


def test_other_interfaces_are_refused():
    world = World(RANDOM)
    with pytest.raises(LayoutError, match="ObserverRelay"):
        ObserverRelay(make_encoder(world, Interface("scaled")).layout)
    with pytest.raises(ValueError, match="patience must be a finite number above 0"):
        spec_of("ObserverRelay", patience=0.0).build(layout=make_encoder(world, Interface("physical")).layout)


# --- the displacement -----------------------------------------------------------------------------------------------


class Drawn(GatedLaw):
    """Random gates, which change in every step."""

    def __init__(self, layout):
        super().__init__(layout)
        self.generator, self.checked = np.random.default_rng(0), 0

    def gates(self, cells, slots):
        draw = self.generator.random
        own = draw((len(CellGates._fields), *cells.own.shape)) * 0.3
        return CellGates(*own), SlotGates(*draw((3, *slots.relative.shape)))

    def follow(self, observation, memory, found, gates, slot_gates):
        inputs, fresh = super().follow(observation, memory, found, gates, slot_gates)
        steps = self._parts.split(memory)["steps"]
        push = self._parts.split(fresh)["push"] * observation.dt
        for row in range(len(observation.player)):
            expected = [
                slow(self.layout, observation, steps, push, found, gates, slot_gates, row, c)
                for c in range(self.layout.dimension)
            ]
            reach = self.layout.action_bound * observation.theta[row]
            moved = inputs[row].astype(float) * observation.theta[row]
            np.testing.assert_allclose(moved, np.clip(expected, -reach, reach), rtol=1e-5, atol=1e-5)
            self.checked += 1
        return inputs, fresh


def slow(layout, observation, steps, push, found, gates, slots, i, c):
    """The displacement of component c of row i by the formula of the class, one sum at a time."""
    x, theta = observation.own_estimate[i], observation.theta[i, 0]
    weights, difference = observation.weights[i], observation.relative_estimates[i]
    own = layout.own_mask[observation.player[i]]
    g = {name: getattr(gates, name)[i] for name in gates._fields}

    def copies(e):
        shares = [slots.copy[i, d, e] if weights[d] > 0 else 0.0 for d in range(len(weights))]
        return sum(p * difference[d, e] for d, p in enumerate(shares)) / (sum(shares) or 1.0)

    def plain(e):
        return 0.0 if own[e] else (1 - g["track"][e]) * g["copies"][e] * copies(e) + g["track"][e] * found.track[i, e]

    def belief(e):
        means = found.means
        trust = [
            slots.mean[i, d, e] * means.samples[i, d, e] / max(means.variance[i, d, e], 1e-14)
            for d in range(len(weights))
        ]
        if sum(trust) == 0:
            return plain(e)
        return sum(t * means.mean[i, d, e] for d, t in enumerate(trust)) / sum(trust) - x[e]

    diffusion = theta * sum(slots.diffusion[i, d, c] * weights[d] * difference[d, c] for d in range(len(weights)))
    if own[c]:
        aim = [0.0 if own[e] else (1 - g["belief"][e]) * plain(e) + g["belief"][e] * belief(e) for e in range(len(x))]
        one = found.own._replace(
            **{
                name: part[i : i + 1] if not isinstance(part, tuple) else type(part)(*(p[i : i + 1] for p in part))
                for name, part in found.own._asdict().items()
            }
        )
        settled = found.settling
        response = settled.damping[i] * one._replace(gradient=one.gradient + settled.expected[i : i + 1]).response(
            np.array([aim])
        )
        place = list(one.blocks[0]).index(c)
        width = found.unrest.width[i, 0] if found.unrest.width[i, 0] < 1e6 else 0.0
        move = g["response"][c] * response[0, place]
        move -= (g["flow"][c] * theta + g["step"][c]) * observation.gradient[i, c]
        move += g["dither"][c] * width * dither(steps[i])[0]
    else:
        move = (1 - g["stated"][c]) * plain(c) + g["stated"][c] * belief(c)
    j = g["joint"][c]
    mixed = (1 - j) * (move + diffusion) + j * (found.joint.point[i, c] - found.here[i, c])
    return mixed - (g["push"][c] * push[i, c] if own[c] else 0.0)


@pytest.mark.parametrize("scenario", [FAULTY, BLOCKS_SWITCHING], ids=lambda scenario: scenario.name)
def test_displacements_are_those_of_the_formula(scenario):
    world, encoder = world_and_encoder(scenario)
    law = Drawn(encoder.layout)
    run(world, encoder, law, begin(world, [0]), 40)
    assert law.checked == 40 * world.game.num_players


# --- against contact-relay ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_observers_see_nothing_on_a_fixed_graph_without_faults(seed):
    matrix, offset, adjacency = random_affine(np.random.default_rng(seed), 4, coupling=0.3)
    scenario = affine_scenario(matrix, offset, fixed_part(adjacency), steps=80)
    found = [episode(scenario, law)[0] for law in (field_laws.ContactRelay, ObserverRelay)]
    np.testing.assert_allclose(*found, rtol=0, atol=1e-9)


GAINS = {
    "ptne-v1": {
        "noise": 0.01,
        "quantised": 1.5,
        "hold": 4.0,
        "switching-physical": 2.5,
        "switching-transformed": 2.0,
        "markov": 0.8,
    },
    "ptne-v2": {"quantised": 1.5, "liar": 0.3, "pushes": 1.5, "weakly-monotone": 1.0, "drift": 1.0},
}
"""Digits that observer-relay gains over contact-relay at least."""
EPISODES = {"noise": 24}
"""Of tracks on which the gain is small; 3 of the others."""


@pytest.mark.parametrize("track", [(suite, name) for suite, names in GAINS.items() for name in names], ids="-".join)
def test_observers_gain_digits(track):
    name, gain = track[1], GAINS[track[0]][track[1]]
    chosen = get_suite(track[0]).track(name)
    found = run_suite(
        Suite("observers", (chosen,), EPISODES.get(name, 3), is_comparison=True),
        [POLICIES["contact-relay"], POLICIES["observer-relay"]],
        split="validation",
    )
    assert not found.failures
    plain, observer = (found.samples[name, law][chosen.metric].mean() for law in ("contact-relay", "observer-relay"))
    assert observer > plain + gain


def test_a_player_leaves_sources_that_follow_it():
    """Two leaves follow the static law; in two episodes the hub copied from them the copy that they had from it."""
    star = FactorySpec.of("ptne_env.world.graphs:from_edges", players=5, edges=[[0, 1], [0, 2], [0, 3], [2, 4]])
    scenario = RANDOM.replace(topology=FactorySpec.of("ptne_env.world.switching:fixed", graph=star))
    leaves = Teammates(FactorySpec.of("ptne_env.laws:Static", kappa=2.0), (1, 3))
    suite = Suite("observers", (Track("leaves", scenario, "Leaves average.", teammates=leaves),), 8, is_comparison=True)
    found = run_suite(suite, [POLICIES["contact-relay"], POLICIES["observer-relay"]], split="validation")
    plain, observer = (found.samples["leaves", law]["digits"] for law in ("contact-relay", "observer-relay"))
    assert (plain < 1).sum() == 2
    assert (observer > 11).all()


def test_observers_do_no_harm_where_best_responses_react_too_strongly_to_each_other():
    """Joint solutions went astray: 2 digits were lost."""
    graphs = [
        FactorySpec.of("ptne_env.world.graphs:from_edges", players=7, edges=edges)
        for edges in (((1, 5), (1, 3), (3, 6), (4, 6), (2, 6)), ((0, 3), (0, 2), (0, 5), (1, 2), (3, 4)))
    ]
    scenario = Scenario(
        "cournot",
        game=FactorySpec.of(
            "ptne_env.games:NetworkedCournot",
            links=((0, 2), (0, 1, 2), (1, 2), (0, 1, 2), (1, 2), (2,), (0, 1)),
            slope=(0.3298, 0.4163, 0.4242),
            capacity=(4.0411, 3.0965, 4.9343, 4.3704, 4.7103, 3.9267, 4.8743),
            marginal_cost=(3.978, 3.5511, 5.7588, 5.0145, 6.8249, 3.9764, 2.0624),
            curvature=(0.5456, 0.8789, 0.6098, 0.5749, 0.8758, 0.883, 0.6716),
        ),
        topology=FactorySpec.of(
            "ptne_env.world.switching:markov",
            clock="transformed",
            graphs=tuple(graphs),
            dwells=(0.0634, 0.237),
            transition=((0.3755, 0.6245), (0.6192, 0.3808)),
        ),
        start=FactorySpec.of("ptne_env.world.starts:UniformStart", low=0.0, high=6.0),
        deadline=0.070944,
        gain=9.7644,
        steps=161,
        s_end=7.1413,
    )
    policies = [POLICIES["contact-relay"], POLICIES["observer-relay"]]
    suite = Suite("observers", (Track("world", scenario, "Reactions."),), 4, is_comparison=True)
    found = run_suite(suite, policies, split="train")
    plain, observer = (found.samples["world", law]["digits"].mean() for law in ("contact-relay", "observer-relay"))
    assert observer > plain - 0.5
