import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.linalg import expm
from worlds import BLOCKS, BLOCKS_SWITCHING, FAULTY, begin, large_energy_scenario, loop_matrix, quantity, stack

from ptne_env import FactorySpec, get_scenario
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import dynamics, graphs, switching
from ptne_env.world.channels import Range
from ptne_env.world.world import RANGE_LIMIT, World

AFFINE = {
    "energy": get_scenario("energy"),
    "energy-switching": get_scenario("energy-switching"),
    "energy-switching-transformed": get_scenario("energy-switching-transformed"),
    "blocks": BLOCKS,
    "blocks-switching": BLOCKS_SWITCHING,
}


STATE_ARRAYS = (
    "step",
    "active_mode",
    "weights",
    "estimates",
    "strategies",
    "relative_estimates",
    "own_gradients",
    "diverged",
)


def start(world, seed=3):
    return world.draw_estimates([RandomStreams.from_seed(seed)])


def inputs_of_static_law(game, estimates, adjacency, kappa):
    """u in float64, from the definition: (n, N, 1) to (n, N, 1)."""
    inputs = np.zeros_like(estimates)
    gradients = game.own_gradients(estimates)
    for i in range(game.num_players):
        own = game.owners == i
        inputs[own, i] -= gradients[own]
        for j in range(game.num_players):
            inputs[:, i] -= kappa * adjacency[i, j] * (estimates[:, i] - estimates[:, j])
    return inputs


def roll(world, estimates, kappa=2.0):
    """All stacked states under the static law, and the adjacency that acted in each step."""
    state, states, acted = dynamics.initial_state(world, estimates), [stack(estimates)], []
    for _ in range(world.clock.total_steps):
        adjacency = world.topology.graphs[int(dynamics.active_mode(world, state)[0])].adjacency
        state = dynamics.step(world, state, inputs_of_static_law(world.game, state.estimates, adjacency, kappa))
        states.append(stack(state.estimates))
        acted.append(adjacency)
    return np.array(states), acted


def active_graph(topology, t, s):
    """The adjacency at an instant, found by walking through the dwells."""
    if topology.is_fixed:
        return topology.graphs[0].adjacency
    now = ((t if topology.clock == "physical" else s) + 1e-9) % sum(topology.dwells)  # a rounded switch is a switch
    for graph, dwell in zip(topology.graphs, topology.dwells, strict=True):
        if now < dwell:
            return graph.adjacency
        now -= dwell
    raise AssertionError(now)


@pytest.mark.parametrize("name", AFFINE)
def test_static_law_is_the_product_of_its_step_matrices(name):
    scenario = AFFINE[name].replace(hold_steps=30)
    world = World(scenario)
    game, clock = world.game, world.clock
    estimates = start(world)
    states, _ = roll(world, estimates)

    equilibrium = np.tile(game.nash_equilibrium, game.num_players)
    error = stack(estimates) - equilibrium
    largest = np.abs(states).max()
    assert len(states) == 431
    for k in range(clock.total_steps):
        s = clock.s[k] if k < clock.steps else clock.s_end + clock.gain * (clock.t[k] - clock.deadline)
        matrix = loop_matrix(game, active_graph(world.topology, clock.t[k], s), 2.0)
        error = (np.eye(error.size) - clock.theta[k] * matrix) @ error
        assert np.abs(states[k + 1] - equilibrium - error).max() <= 1e-12 * largest


@pytest.mark.parametrize("scenario", [get_scenario("energy"), BLOCKS], ids=lambda scenario: scenario.name)
def test_halving_the_step_halves_the_distance_to_the_continuous_solution(scenario):
    game, gaps = World(scenario).game, []
    for steps in (400, 800, 1600):
        world = World(scenario.replace(steps=steps, s_end=5.0, gain=2.0))
        estimates = start(world)
        states, _ = roll(world, estimates)
        equilibrium = np.tile(game.nash_equilibrium, game.num_players)
        matrix = loop_matrix(game, World(scenario).topology.graphs[0].adjacency, 2.0)
        exact = equilibrium + expm(-matrix * world.clock.effective_time) @ (stack(estimates) - equilibrium)
        gaps.append(np.abs(states[-1] - exact).max())
    assert gaps[0] / gaps[1] == pytest.approx(2.0, abs=0.1)
    assert gaps[1] / gaps[2] == pytest.approx(2.0, abs=0.05)


def test_padded_slots_hold_the_player_itself_with_weight_zero():
    star = get_scenario("energy", topology=FactorySpec.of("ptne_env.world.graphs:star", players=5))
    world = World(star)
    assert world.slots == 4
    assert world.neighbours[:, 0].tolist() == [1, 2, 3, 4]
    state = dynamics.initial_state(world, start(world))
    for i in range(1, 5):
        assert world.neighbours[:, i].tolist() == [0, i, i, i]
        assert dynamics.weights(world, state)[:, i, 0].tolist() == [1, 0, 0, 0]
        assert not dynamics.relative_estimates(world, state)[1:, :, i].any()


PUSH = "disturbance:uniform"


def test_a_disturbance_is_bounded_and_pushes_only_the_strategies():
    plain = World(get_scenario("energy", start="paper", hold_steps=30))
    pushed = World(get_scenario("energy", start="paper", hold_steps=30, disturbance=FactorySpec.of(PUSH, bound=2.0)))
    states = [begin(plain, [1, 2]), begin(pushed, [1, 2])]
    shares = []
    for k in range(430):
        before = states[1].estimates
        states = [
            dynamics.step(plain, states[0], np.zeros_like(before)),
            dynamics.step(pushed, states[1], np.zeros_like(before)),
        ]
        moved = states[1].estimates - before
        own = np.einsum("iib->ib", moved)
        assert np.array_equal(moved[~np.eye(5, dtype=bool)], np.zeros((20, 2)))
        shares.append(own / plain.clock.dt[k])
        assert np.abs(own).max() <= 2.0 * plain.clock.dt[k] * (1 + 1e-9) + 1e-14
        assert np.array_equal(
            states[0].estimates, dynamics.initial_state(plain, start(plain)).estimates.repeat(2, axis=2)
        )
    drawn = np.array(shares[:200])  # later on Δt is so small that rounding shows
    assert stats.kstest(drawn.ravel() / 4 + 0.5, "uniform").pvalue > 1e-6  # false alarms: one in a million
    assert abs(np.corrcoef(drawn[1:].ravel(), drawn[:-1].ravel())[0, 1]) < stats.norm.isf(5e-7) / np.sqrt(1990)


def test_a_disturbance_may_last():
    push = FactorySpec.of(PUSH, bound=2.0, dwell=10)
    world = World(get_scenario("energy", steps=20, hold_steps=20, disturbance=push))
    state, moves = begin(world, [1]), []
    for _ in range(40):
        following = dynamics.step(world, state, np.zeros_like(state.estimates))
        moves.append((dynamics.strategies(following) - dynamics.strategies(state))[:, 0])
        state = following
    assert np.array_equal(np.round(moves[20:30], 12), np.tile(np.round(moves[20], 12), (10, 1)))
    assert np.abs(moves[30] - moves[29]).max() > 1e-3


@pytest.mark.parametrize("name", ["energy-switching", "energy-switching-transformed"])
def test_graph_of_a_step_is_the_one_at_its_start(name):
    scenario = get_scenario(name, hold_steps=60)
    world, clock = World(scenario), World(scenario).clock
    dwell = World(scenario).topology.dwells[0]
    state = dynamics.initial_state(world, start(world))
    seen = set()
    for k in range(clock.total_steps):
        if name.endswith("transformed"):
            now = clock.s[k] if k < clock.steps else 8.0 + 20.0 * (clock.t[k] - 1.2)
        else:
            now = clock.t[k]
        mode, dwelt = int(dynamics.active_mode(world, state)[0]), now / dwell + 1e-9
        assert mode == int(np.floor(dwelt)) % 4
        assert np.array_equal(dynamics.graph_weights(world, state)[..., 0], world.mode_weights[..., mode])
        assert world.time_since_switch[k] == pytest.approx(dwelt % 1.0, abs=1e-6)
        seen.add(mode)
        state = dynamics.step(world, state, np.zeros_like(state.estimates))
    assert seen == {0, 1, 2, 3}


def test_random_graph_of_a_step_is_the_one_at_its_start():
    pool = [graphs.cycle(5), graphs.path(5), graphs.star(5)]
    world = World(get_scenario("energy", topology=switching.RandomTopology(pool, (0.1, 0.2)), channel=Range(50.0)))
    streams = [RandomStreams.from_seed(seed).graph for seed in range(8)]
    schedule = world.topology.draw(world.clock.t, streams)
    state, changes = begin(world, range(8)), np.diff(schedule.modes, axis=0)
    for k in range(world.clock.total_steps):
        assert np.array_equal(dynamics.active_mode(world, state), schedule.modes[k])
        assert dynamics.time_since_switch(world, state) == pytest.approx(schedule.time_since_switch[k], abs=1e-6)
        weights = np.stack([world.mode_weights[..., mode] for mode in schedule.modes[k]], axis=-1)
        assert np.array_equal(dynamics.weights(world, state), weights)
        state = dynamics.step(world, state, np.zeros_like(state.estimates))
    assert np.count_nonzero(changes) > 20


def test_a_merged_state_goes_on_as_its_environments_do_alone():
    world = World(FAULTY)
    old, fresh = begin(world, [0, 1, 2, 3]), begin(world, [4, 5])
    for _ in range(5):
        old = dynamics.step(world, old, np.ones_like(old.estimates))
    mask = np.array([False, True, False, True])
    merged = dynamics.merge(old, fresh, mask)
    for name in STATE_ARRAYS:
        whole, before, new = (quantity(world, state, name) for state in (merged, old, fresh))
        assert np.array_equal(whole[..., mask], new), name
        assert np.array_equal(whole[..., ~mask], before[..., ~mask]), name
    assert not np.array_equal(merged.own_gradients, old.own_gradients)


def test_step_leaves_its_arguments_alone():
    world = World(get_scenario("energy-switching"))
    state = dynamics.initial_state(world, start(world))
    inputs = np.random.default_rng(0).normal(size=state.estimates.shape)
    kept = {name: np.copy(quantity(world, state, name)) for name in STATE_ARRAYS}, inputs.copy()
    dynamics.step(world, dynamics.step(world, state, inputs), inputs)
    assert all(np.array_equal(quantity(world, state, name), copy) for name, copy in kept[0].items())
    assert np.array_equal(inputs, kept[1])


def test_time_stands_still_after_the_last_step():
    world = World(get_scenario("energy", steps=3, hold_steps=2))
    state = dynamics.initial_state(world, start(world))
    for k in range(5):
        assert not dynamics.is_over(world, state)[0]
        assert state.step[0] == k
        state = dynamics.step(world, state, np.ones_like(state.estimates))
    assert dynamics.is_over(world, state)[0]
    after = dynamics.step(world, state, np.ones_like(state.estimates))
    assert after.step[0] == 5
    assert np.array_equal(after.estimates, state.estimates)


BATCHED = {
    **{
        name: get_scenario(name, start="random", input_limit=1e9)
        for name in (
            "energy",
            "non-quadratic-switching",
            "random-energy-switching-transformed",
            "robots",
            "ev-charging",
        )
    },
    "blocks-switching": BLOCKS_SWITCHING,
    "large": large_energy_scenario(),
    "faulty": FAULTY.replace(input_limit=1e9),
}


@pytest.mark.parametrize("name", BATCHED)
def test_a_batch_with_a_diverged_member_equals_batches_of_one(name):
    world = World(BATCHED[name])
    batch = 7
    together = begin(world, range(batch))
    alone = [begin(world, [b]) for b in range(batch)]
    generator = np.random.default_rng(0)
    for k in range(60):
        inputs = generator.normal(size=together.estimates.shape)
        if k == 20:
            inputs[:, :, 3] = 1e8  # the fourth environment leaves the range
        together = dynamics.step(world, together, inputs)
        for b in range(batch):
            alone[b] = dynamics.step(world, alone[b], inputs[:, :, b : b + 1])
            for name_ in STATE_ARRAYS:
                whole, single = quantity(world, together, name_), quantity(world, alone[b], name_)
                part = whole if whole.shape == single.shape and name_ == "weights" else whole[..., b : b + 1]
                assert np.array_equal(part, single), name_
    assert together.diverged.tolist() == [b == 3 for b in range(batch)]


@pytest.mark.parametrize("value", [1e9, -1e9, 1e300])
def test_a_diverged_state_stays_finite_and_constant(value):
    world = World(get_scenario("non-quadratic"))
    state = dynamics.initial_state(world, start(world))
    state = dynamics.step(world, state, np.full_like(state.estimates, value))
    assert state.diverged.tolist() == [True]
    assert dynamics.is_over(world, state).tolist() == [True]
    for field in (state.estimates, state.own_gradients, dynamics.relative_estimates(world, state)):
        assert np.all(np.isfinite(field))
    assert np.abs(state.estimates).max() == RANGE_LIMIT
    assert np.abs(state.own_gradients).max() <= RANGE_LIMIT
    after = dynamics.step(world, state, np.ones_like(state.estimates))
    assert after.diverged.tolist() == [True]
    assert np.array_equal(after.estimates, state.estimates)


def test_gradient_out_of_range_is_divergence_even_with_estimates_in_range():
    world = World(get_scenario("non-quadratic"))
    estimates = np.zeros((5, 5, 1))
    estimates[1, 1] = 40.0  # e^{20}/4 = 1.2e8
    state = dynamics.begin(world, estimates, world.game, None)
    assert state.diverged.tolist() == [True]


def test_range_is_inclusive():
    world = World(large_energy_scenario(input_limit=1e9))
    at_limit = dynamics.initial_state(world, np.zeros((11, 11, 1)))
    inputs = np.zeros((11, 11, 1))
    inputs[0, 1] = RANGE_LIMIT / world.clock.theta[0]
    moved = dynamics.step(world, at_limit, inputs)
    assert moved.estimates[0, 1, 0] == pytest.approx(RANGE_LIMIT)
    inputs[0, 1] *= 1.001
    assert dynamics.step(world, at_limit, inputs).diverged.tolist() == [True]
    inputs[0, 1] /= 1.002
    assert dynamics.step(world, at_limit, inputs).diverged.tolist() == [False]


@given(st.integers(0, 2**32 - 1))
def test_the_distance_of_divergence_exceeds_any_in_range(seed):
    world = World(get_scenario("energy"))
    corner = np.random.default_rng(seed).choice([-RANGE_LIMIT, RANGE_LIMIT], 5)
    equilibrium = world.game.nash_equilibrium
    distance = np.linalg.norm(corner - equilibrium) / np.linalg.norm(equilibrium)
    limit = dynamics.distance_limit(world.game)
    assert distance <= limit[0] <= 1.001 * distance


@pytest.mark.parametrize(
    ("estimates", "message"),
    [
        (np.zeros((5, 4, 1)), r"have the shape \(5, 5, 'B'\), got \(5, 4, 1\)"),
        (np.full((5, 5, 1), np.nan), "finite and within"),
        (np.full((5, 5, 1), 6e5), "finite and within ±500000"),
    ],
)
def test_impossible_initial_estimates_are_refused(estimates, message):
    with pytest.raises(ValueError, match=message):
        dynamics.initial_state(World(get_scenario("energy")), estimates)


def test_strategies_of_unequal_dimensions_are_the_own_blocks():
    world = World(BLOCKS)
    estimates = np.arange(18.0).reshape(6, 3, 1)
    assert dynamics.strategies(dynamics.initial_state(world, estimates))[:, 0].tolist() == [0, 3, 7, 11, 14, 17]


def test_a_step_projects_the_strategies_into_the_box_and_leaves_estimates_of_others_outside():
    world = World(get_scenario("ev-charging"))
    players, dimension = world.game.num_players, world.game.dimension
    inside = dynamics.initial_state(world, np.zeros((dimension, players, 1)))
    outside = dynamics.step(world, inside, np.full((dimension, players, 1), -500.0))
    free = -500.0 * world.clock.theta[0]
    assert np.array_equal(dynamics.strategies(outside), world.game.project(np.full((dimension, 1), free)))
    others = np.arange(players) != world.game.owners[:, None]
    assert outside.estimates[others] == pytest.approx(free)
