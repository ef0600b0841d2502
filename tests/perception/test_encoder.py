from itertools import pairwise

import numpy as np
import pytest
from worlds import BLOCKS, BLOCKS_SWITCHING, FAULTY, begin, every_field, whole_interface, world_and_encoder

from ptne_env import CATALOGUE, get_scenario, laws
from ptne_env.perception.fields import FIELDS
from ptne_env.world import dynamics
from ptne_env.world.world import RANGE_LIMIT

KINDS = ["scaled", "physical", "full"]

WORLDS = {
    **{name: get_scenario(name, start="random") for name in CATALOGUE},
    "blocks": BLOCKS,
    "blocks-switching": BLOCKS_SWITCHING,
}


def wander(world, steps=37, batch=2, seed=0):
    """A state somewhere along the way."""
    generator = np.random.default_rng(seed)
    state = begin(world, range(seed, seed + batch))
    for _ in range(steps):
        state = dynamics.step(world, state, 0.1 * generator.normal(size=state.estimates.shape))
    return state


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", WORLDS)
def test_named_slices_cover_the_observation_without_gaps(name, kind):
    _, encoder = world_and_encoder(WORLDS[name], kind=kind)
    parts = list(encoder.layout.slices.values())
    assert parts[0].start == 0
    assert all(part.stop == following.start for part, following in pairwise(parts))
    assert parts[-1].stop == encoder.layout.size == encoder.layout.observation_space().shape[0]
    assert all(part.stop > part.start for part in parts)


@pytest.mark.parametrize("name", WORLDS)
def test_a_physical_observation_follows_the_table_of_slices(name):
    world, encoder = world_and_encoder(WORLDS[name])
    state, layout, game = wander(world), encoder.layout, world.game
    observations = encoder.observe(state)
    clock, k = world.clock, int(state.step[0])
    for b in range(2):
        adjacency = world.topology.graphs[int(dynamics.active_mode(world, state)[b])].adjacency
        for i in range(game.num_players):
            estimate = state.estimates[:, i, b]
            own = game.owners == i
            gradient = np.zeros(max(game.action_dims))
            gradient[: own.sum()] = state.own_gradients[own, b]
            neighbours = [j for j in range(game.num_players) if world.topology.union.adjacency[i, j] > 0]
            relative = np.zeros((layout.slots, game.dimension))
            weights = np.zeros(layout.slots)
            for slot, j in enumerate(neighbours):
                weights[slot] = adjacency[i, j]
                relative[slot] = (state.estimates[:, j, b] - estimate) * (adjacency[i, j] > 0)
            one_hot = np.eye(game.num_players)[i]
            time = [clock.t[k] / clock.deadline, clock.s[k], clock.theta[k], clock.dt[k] / clock.deadline]
            expected = [gradient, estimate, relative.ravel(), weights, time, [world.time_since_switch[k]], one_hot]
            assert np.array_equal(observations[b, i], np.concatenate(expected).astype(np.float32))


@pytest.mark.parametrize("name", WORLDS)
def test_scaled_observation_has_no_unit_and_in_ego_order(name):
    world, encoder = world_and_encoder(WORLDS[name], kind="scaled")
    state, layout, game = wander(world), encoder.layout, world.game
    n = game.dimension
    observations = encoder.observe(state)
    assert "own_estimate" not in layout.slices
    for i in range(game.num_players):
        own = game.owners == i
        gradient = state.own_gradients[own, 0]
        scale = max(np.abs(gradient).max(), np.abs(dynamics.relative_estimates(world, state)[:, :, i, 0]).max())
        row = observations[0, i]
        padded = np.zeros(max(game.action_dims))
        padded[: own.sum()] = gradient / scale
        assert layout.select(row, "own_gradient") == pytest.approx(padded, rel=1e-6)
        assert layout.select(row, "log_scale")[0] == pytest.approx(np.log10(scale) / 10, rel=1e-6)
        first = int(np.flatnonzero(own)[0])
        cyclic = [(first + c) % n for c in range(n)]
        assert list(layout.neighbours[i]) == sorted(layout.neighbours[i], key=lambda j: (j - i) % game.num_players or n)
        for slot, neighbour in enumerate(layout.neighbours[i]):
            seen = layout.select(row, "relative_estimates").reshape(layout.slots, n)[slot]
            place = world.neighbours[:, i].tolist().index(neighbour)
            assert seen == pytest.approx(
                dynamics.relative_estimates(world, state)[place, cyclic, i, 0] / scale, rel=1e-6, abs=1e-30
            )
        assert np.abs(layout.select(row, "relative_estimates")).max() <= 1


@pytest.mark.parametrize("factor", [1e-9, 1e-3, 1e3])
def test_a_scaled_error_changes_only_the_scale_of_a_scaled_observation(factor):
    world, encoder = world_and_encoder("energy", kind="scaled")
    equilibrium = world.game.nash_equilibrium[:, None, None]
    error = np.random.default_rng(0).integers(-8, 8, (5, 5, 1)) / 8
    near, far = (
        encoder.observe(dynamics.initial_state(world, equilibrium + scale * error))[0] for scale in (1.0, factor)
    )
    part = encoder.layout.slices["log_scale"]
    assert (far - near)[:, part] == pytest.approx(np.full((5, 1), np.log10(factor) / 10), abs=2e-6)
    rest = np.ones(encoder.layout.size, dtype=bool)
    rest[part] = False
    assert far[:, rest] == pytest.approx(near[:, rest], abs=1e-5)


def test_player_at_rest_observes_the_smallest_scale():
    world, encoder = world_and_encoder(BLOCKS, kind="scaled")
    at_rest = np.repeat(np.zeros((6, 1)), 3, axis=1)[:, :, None]
    moving = dynamics.initial_state(world, at_rest)
    state = moving._replace(estimates=at_rest, own_gradients=np.zeros((6, 1)))
    observations = encoder.observe(state)
    assert encoder.layout.select(observations, "log_scale") == pytest.approx(np.full((1, 3, 1), -3.0))
    assert encoder.layout.observation_space().contains(observations[0, 0])


@pytest.mark.parametrize("name", WORLDS)
def test_oracle_sees_the_equilibrium_besides(name):
    world, encoder = world_and_encoder(WORLDS[name], kind="full")
    state, layout = wander(world), encoder.layout
    observations = encoder.observe(state)
    plain = world_and_encoder(WORLDS[name])[1].observe(state)
    assert np.array_equal(observations[:, :, : plain.shape[2]], plain)
    for i in range(layout.num_players):
        relative = (state.game.nash_equilibria - state.estimates[:, i]).T.astype(np.float32)
        assert np.array_equal(layout.select(observations, "relative_equilibrium")[:, i], relative)


def test_differences_are_taken_before_the_cast_to_float32():
    world, encoder = world_and_encoder("energy")
    estimates = np.full((5, 5, 1), 12345.678)
    estimates[2, 1] += 1e-9
    observation = encoder.observe(dynamics.initial_state(world, estimates))[0]
    seen = encoder.layout.select(observation[0], "relative_estimates").reshape(2, 5)
    assert seen[0, 2] == pytest.approx(1e-9, rel=1e-2)  # 12345.678 + 1e-9 has that much rounding in float64
    assert np.count_nonzero(seen) == 1


def test_terminal_observation_has_no_step_left():
    world, encoder = world_and_encoder(get_scenario("energy", steps=5, hold_steps=3))
    clock = encoder.layout.select(encoder.observe(wander(world, steps=8)), "clock")[0, 0]
    assert clock[2:].tolist() == [0, 0]
    assert clock[0] == pytest.approx(world.clock.t[-1] / 1.2)
    assert clock[1] == 8.0


@pytest.mark.parametrize("scenario", [*map(WORLDS.get, ("energy", "energy-switching", "blocks-switching")), FAULTY])
@pytest.mark.parametrize(("name", "interface"), every_field())
def test_a_field_is_that_of_the_state_also_where_it_is_tabulated(name, interface, scenario):
    """JAX reads the tables of numpy, so it cannot tell that a field follows more than the step."""
    world, encoder = world_and_encoder(scenario, interface)
    state = wander(world)._replace(step=np.array([37, 9]))
    value = np.float32(FIELDS[name].value(encoder.look(world, state)))
    found = encoder.layout.select(encoder.observe(state), name).transpose(2, 1, 0)
    assert np.array_equal(found, np.broadcast_to(value, found.shape))


@pytest.mark.parametrize("units", ["scaled", "physical"])
@pytest.mark.parametrize("name", WORLDS)
def test_space_contains_every_observation_also_at_the_edge_of_the_range(name, units):
    world, encoder = world_and_encoder(WORLDS[name], whole_interface(units))
    space, players, n = encoder.layout.observation_space(), encoder.layout.num_players, encoder.layout.dimension
    shape = (n, players, 1)
    corners = np.random.default_rng(0).choice([-RANGE_LIMIT, RANGE_LIMIT], shape)
    game = begin(world, [0]).game
    edge = [dynamics.begin(world, estimates, game, None) for estimates in (corners, np.zeros(shape))]
    states = [*edge, wander(world), wander(world, steps=400)]
    crashed = dynamics.step(world, states[1], np.full(shape, 1e9))
    assert crashed.diverged.all()
    for state in [*states, crashed]:
        observations = encoder.observe(state)
        assert observations.dtype == np.float32
        for row in observations.reshape(-1, encoder.layout.size):
            assert space.contains(row)


# --- actions ----------------------------------------------------------------------------------------------------------


def test_physical_action_is_the_input_clipped_to_the_limit():
    world, encoder = world_and_encoder(get_scenario("energy", input_limit=7.0))
    state = wander(world)
    actions = np.random.default_rng(0).uniform(-10, 10, (2, 5, 5)).astype(np.float32)
    inputs, clipped = encoder.decode(actions, state), encoder.clip(actions)[1]
    for b in range(2):
        for i in range(5):
            assert np.array_equal(inputs[:, i, b], np.clip(actions[b, i], -7.0, 7.0))
    assert np.array_equal(clipped, (np.abs(actions) > 7).sum(axis=2))
    assert encoder.layout.action_space().high.tolist() == [7.0] * 5


@pytest.mark.parametrize("name", ["energy", "blocks", "blocks-switching"])
def test_scaled_action_is_in_units_of_the_scale_and_in_ego_order(name):
    world, encoder = world_and_encoder(get_scenario(WORLDS[name], input_limit=30.0), kind="scaled")
    state, game, n = wander(world), world.game, encoder.layout.dimension
    actions = np.random.default_rng(0).uniform(-1.5, 1.5, (2, game.num_players, n)).astype(np.float32)
    inputs, clipped = encoder.decode(actions, state), encoder.clip(actions)[1]
    scale = 1e10 ** encoder.layout.select(encoder.observe(state), "log_scale")[..., 0].astype(np.float64)
    saturated = 0
    for b in range(2):
        for i in range(game.num_players):
            for place in range(n):
                component = (sum(game.action_dims[:i]) + place) % n
                wanted = np.clip(actions[b, i, place], -1, 1) * 5 / 3 * scale[b, i]
                saturated += abs(wanted) > 30
                assert inputs[component, i, b] == pytest.approx(np.clip(wanted, -30, 30), rel=2e-5)
    assert saturated > 0
    assert np.array_equal(clipped, (np.abs(actions) > 1).sum(axis=2))
    assert encoder.layout.action_space().high.tolist() == [1.0] * n


def test_a_scaled_action_uses_the_scale_of_its_own_state():
    world, encoder = world_and_encoder("energy", kind="scaled")
    first, second = wander(world, steps=0), wander(world, steps=80)
    actions = np.random.default_rng(0).uniform(-1, 1, (2, 5, 5)).astype(np.float32)
    expected = [world_and_encoder("energy", kind="scaled")[1].decode(actions, state) for state in (first, second)]
    assert not np.array_equal(*expected)
    encoder.observe(first)
    assert np.array_equal(encoder.decode(actions, second), expected[1])
    assert np.array_equal(encoder.decode(actions, first), expected[0])


def test_input_limit_that_float32_cannot_hold_is_never_exceeded():
    world, encoder = world_and_encoder(get_scenario("energy", input_limit=0.1))
    state = wander(world)
    assert np.abs(encoder.decode(np.full((2, 5, 5), 9.0, dtype=np.float32), state)).max() <= 0.1


def test_observations_of_another_layout_are_refused_with_both_sizes():
    layout = world_and_encoder("energy")[1].layout
    with pytest.raises(ValueError, match=rf"length {layout.size} .*5 players, 2 neighbour slots.*\(1, 7\)"):
        layout.read(np.zeros((1, 7), dtype=np.float32))


@pytest.mark.parametrize("kind", ["physical", "full"])
@pytest.mark.parametrize("name", ["energy-switching", "blocks"])
def test_reading_restores_natural_units_and_player_order(name, kind):
    world, encoder = world_and_encoder(WORLDS[name], kind=kind)
    state, game, layout = wander(world), world.game, encoder.layout
    reading = layout.read(encoder.observe(state)[1])
    assert reading.player.tolist() == list(range(layout.num_players))
    for i in range(layout.num_players):
        gradient = np.where(game.owners == i, state.own_gradients[:, 1], 0)
        assert reading.gradient[i] * reading.unit[i] == pytest.approx(gradient, rel=3e-6)
        relative = dynamics.relative_estimates(world, state)[:, :, i, 1]
        assert reading.relative_estimates[i] * reading.unit[i] == pytest.approx(relative, rel=3e-6, abs=1e-12)
        assert np.array_equal(reading.weights[i], dynamics.weights(world, state)[:, i, -1])
    k = int(state.step[1])
    assert reading.theta[:, 0] == pytest.approx(np.full(layout.num_players, world.clock.theta[k]), rel=1e-7)
    assert reading.dt[:, 0] == pytest.approx(np.full(layout.num_players, world.clock.dt[k]), rel=2e-7)


@pytest.mark.parametrize("kind", ["physical", "scaled"])
def test_written_inputs_are_the_inputs_that_arrive(kind):
    world, encoder = world_and_encoder(BLOCKS, kind=kind)
    state = wander(world, batch=1)
    reading = encoder.layout.read(encoder.observe(state)[0])
    wanted = np.random.default_rng(0).uniform(-1, 1, (3, 6))
    arrived = encoder.decode(encoder.layout.write(wanted, reading)[None], state)[:, :, 0].T
    assert arrived == pytest.approx(wanted * reading.unit, rel=3e-6)


@pytest.mark.parametrize("kind", ["physical", "full"])
def test_observations_hold_received_messages(kind):
    world, encoder = world_and_encoder(FAULTY, kind=kind)
    state, layout = wander(world, steps=25), encoder.layout
    reading = layout.read(encoder.observe(state).reshape(10, -1))
    relative, weights = dynamics.relative_estimates(world, state), dynamics.weights(world, state)
    for b in range(2):
        for i in range(5):
            row = 5 * b + i
            assert reading.weights[row] == pytest.approx(weights[:, i, b], rel=1e-6)
            found = reading.relative_estimates[row] * reading.unit[row]
            assert found == pytest.approx(relative[:, :, i, b], rel=1e-5, abs=1e-5)
        age = layout.select(encoder.observe(state)[b, 0], "time_since_switch")
        assert age[0] == np.float32(dynamics.time_since_switch(world, state)[b])
    assert len(set(dynamics.time_since_switch(world, state))) == 2  # episodes draw their own topologies


@pytest.mark.parametrize("name", [name for name in WORLDS if "non-quadratic" not in name])  # whose gradients are huge
def test_laws_act_alike_through_scaled_and_physical_where_no_action_saturates(name):
    (world, physical), (_, scaled) = (world_and_encoder(WORLDS[name], kind=kind) for kind in ("physical", "scaled"))
    state, players = wander(world), world.game.num_players
    inputs = []
    for encoder in (physical, scaled):
        actions, _ = laws.Static(encoder.layout, kappa=0.1).predict(encoder.observe(state).reshape(2 * players, -1))
        assert np.abs(actions).max() < encoder.layout.action_bound
        inputs.append(encoder.decode(actions.reshape(2, players, -1), state))
    np.testing.assert_allclose(inputs[0], inputs[1], rtol=1e-5, atol=1e-5 * np.abs(inputs[0]).max())
