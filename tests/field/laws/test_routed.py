"""Routed laws: the path of every copy, gradient play with delays, and what is promised for it."""

import numpy as np
import pytest
from affine_games import SOAK, affine_scenario, random_affine
from affine_games import run as run_batch
from sample_laws import condition_on
from worlds import BLOCKS, begin, fixed_part, world_and_encoder

from ptne_env import FactorySpec, evaluate, get_scenario, theory
from ptne_env.evaluation import run_suite
from ptne_env.field import laws as field_laws
from ptne_env.field.laws.routed import nearer_slots, stamps
from ptne_env.perception.observation import LayoutError
from ptne_env.theory.delayed_play import delayed_play_matrix

SEEDS = range(100 if SOAK else 12)
PATH = FactorySpec.of("ptne_env.world.switching:fixed", graph=FactorySpec.of("ptne_env.world.graphs:path", players=4))


def hops_of(adjacency):
    """Hop counts by Floyd's algorithm."""
    hops = np.where(adjacency > 0, 1.0, np.inf)
    np.fill_diagonal(hops, 0)
    for middle in range(len(hops)):
        hops = np.minimum(hops, hops[:, [middle]] + hops[[middle]])
    return hops.astype(int)


def random_fixed(seed, **fields):
    """A random affine scenario on a fixed graph, its matrix, and hop counts."""
    matrix, offset, adjacency = random_affine(np.random.default_rng(seed), 3 + seed % 4)
    return affine_scenario(matrix, offset, fixed_part(adjacency), **fields), matrix, hops_of(adjacency)


def episode(law, scenario, seeds=(0,), **arguments):
    """The world, and all estimates (K+1, n, N, B) of a law in the scenario."""
    world, encoder = world_and_encoder(scenario, graph_knowledge=law.interface.graph_knowledge)
    return world, run_batch(world, encoder, law(encoder.layout, **arguments), begin(world, seeds))


@pytest.mark.parametrize("law", [field_laws.Routed, field_laws.RoutedUnknown, field_laws.Freshest])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_copy_is_what_the_owner_had_as_many_steps_ago_as_there_are_links(law, seed):
    scenario, matrix, hops = random_fixed(seed, input_limit=1e5)
    step = 0.5 / np.diag(matrix).max()
    world, states = episode(law, scenario, seeds=(seed, seed + 1), step=step)
    late = 2 * hops.max()
    for i, o in np.argwhere(hops >= 0):
        copies, sent = states[late:, o, i], states[late - hops[i, o] : len(states) - hops[i, o], o, o]
        np.testing.assert_allclose(copies, sent, rtol=0, atol=2e-5)
    for k in (late, late + 7):
        gradients = np.einsum("ic,cib->ib", matrix, states[k]) + world.game.offset[:, None]
        expected = np.einsum("iib->ib", states[k]) - step * gradients
        np.testing.assert_allclose(np.einsum("iib->ib", states[k + 1]), expected, rtol=0, atol=2e-5)


def test_estimates_move_to_the_mean_of_all_live_nearer_neighbours():
    """On a square of unequal weights the player across from the owner has two nearer neighbours."""
    adjacency = np.array([[0, 2.0, 0, 0.5], [2.0, 0, 1, 0], [0, 1, 0, 3.0], [0.5, 0, 3.0, 0]])
    scenario = affine_scenario(np.eye(4), np.zeros(4), fixed_part(adjacency))
    _, states = episode(field_laws.Routed, scenario)
    np.testing.assert_allclose(states[1, 0, 2], (states[0, 0, 1] + states[0, 0, 3]) / 2, atol=1e-5)
    np.testing.assert_allclose(states[1, 0, 1], states[0, 0, 0], atol=1e-5)


def test_nothing_but_the_own_block_moves_where_no_source_is_live():
    world, states = episode(field_laws.Routed, get_scenario("energy-switching", start="random"))
    live = world.topology.graphs[0].adjacency > 0
    hops = hops_of(world.topology.union.adjacency)
    for i in range(5):
        for o in range(5):
            sources = [j for j in range(5) if live[i, j] and hops[j, o] < hops[i, o]]
            held = np.array_equal(states[1, o, i], states[0, o, i])
            assert held is (i != o and not sources), (i, o)


def test_players_of_several_dimensions_have_the_hop_counts_of_their_blocks():
    layout = world_and_encoder(BLOCKS, graph_knowledge="union")[1].layout
    owners, neighbours = [0, 0, 1, 2, 2, 2], np.array(layout.neighbours)
    nearer = nearer_slots(layout)
    for i, slot in np.ndindex(neighbours.shape):
        j = neighbours[i, slot]
        assert nearer[i, slot].tolist() == [abs(j - o) < abs(i - o) for o in owners]
    _, states = episode(field_laws.Routed, BLOCKS)
    assert np.abs(states[-1] - states[-1].mean(axis=1, keepdims=True)).max() < 1e-5


@pytest.mark.parametrize("seed", SEEDS)
def test_largest_step_is_where_the_loop_of_the_law_itself_becomes_unstable(seed):
    scenario, matrix, hops = random_fixed(seed)
    world, encoder = world_and_encoder(scenario, graph_knowledge="union")
    largest = theory.largest_delayed_step(matrix, hops)

    def radius(step):
        loop = theory.law_loop(field_laws.Routed(encoder.layout, step), world.game, world.topology.graphs[0])
        return np.abs(np.linalg.eigvals(np.eye(len(loop.matrix)) - loop.matrix)).max()

    assert radius(0.999 * largest) < 1 < radius(1.001 * largest)
    for step in (0.3 * largest, 0.999 * largest, 1.001 * largest):
        found = condition_on(scenario, field_laws.Routed, step=step)
        assert found.holds is (step < largest)
        assert found.value == pytest.approx(theory.delayed_play_radius(matrix, hops, step))


def test_delayed_play_takes_the_steps_of_its_recursion():
    generator = np.random.default_rng(0)
    matrix, errors = generator.normal(size=(4, 4)), list(generator.normal(size=(4, 4)))
    hops = hops_of(np.eye(4, k=1) + np.eye(4, k=-1))
    moved = delayed_play_matrix(matrix, hops, 0.3) @ np.concatenate(errors)
    expected = [errors[0][c] - 0.3 * sum(matrix[c, b] * errors[hops[c, b]][b] for b in range(4)) for c in range(4)]
    np.testing.assert_allclose(moved, [*expected, *np.concatenate(errors[:3])])


def test_certificate_follows_the_law_from_step_to_step():
    matrix, offset, adjacency = random_affine(np.random.default_rng(3), 5)
    scenario = affine_scenario(matrix, offset, fixed_part(adjacency), input_limit=1e5)
    world, states = episode(field_laws.Routed, scenario, step=0.2)
    law = field_laws.Routed(world_and_encoder(scenario, graph_knowledge="union")[1].layout, 0.2)
    errors = theory.sampled_loop(world, law).errors(theory.start_error(states[0, ..., 0], world.game))
    for k in (1, 7, 20):
        found = theory.start_error(states[k], world.game)[:, 0]
        np.testing.assert_allclose(errors[k], found, rtol=0, atol=1e-5)
    assert np.abs(errors[20]).max() > 0.01


def dominant_affine(generator, players):
    """A random matrix, not symmetric and dominant only in hidden weights, with ρ(D⁻¹ |dF − D|) = 0.9."""
    matrix = generator.uniform(-1, 1, (players, players))
    np.fill_diagonal(matrix, 0)
    matrix *= 0.9 / np.abs(np.linalg.eigvals(np.abs(matrix))).max()
    scales = generator.uniform(0.5, 2, players)
    weights = generator.uniform(0.3, 3, players)
    matrix = weights[:, None] * matrix / weights
    return scales[:, None] * (matrix + np.eye(players)), scales


@pytest.mark.parametrize("seed", SEEDS)
def test_dominance_keeps_all_copies_in_a_box_that_shrinks_for_every_schedule(seed):
    generator = np.random.default_rng(seed)
    players = 3 + seed % 4
    matrix, scales = dominant_affine(generator, players)
    assert theory.coupling_radius(matrix) == pytest.approx(0.9)
    comparison = np.abs(matrix / np.diag(matrix)[:, None]) - np.eye(players)
    values, vectors = np.linalg.eig(comparison)
    box = np.abs(vectors[:, values.real.argmax()].real)
    *_, adjacency = random_affine(generator, players)
    hops, step = hops_of(adjacency), 1 / scales.max()
    errors = generator.uniform(-1, 1, (players, players)) * box  # row i: e^i
    largest = np.abs(errors / box).max()
    start = largest
    for _ in range(1500):
        live = np.triu((generator.random((players, players)) < 0.3) & (adjacency > 0))
        live |= live.T
        new = errors.copy()
        for i, o in np.ndindex(players, players):
            sources = [j for j in range(players) if live[i, j] and hops[j, o] < hops[i, o]]
            if sources:
                new[i, o] = errors[sources, o].mean()
        diagonal = np.arange(players)
        new[diagonal, diagonal] -= step * np.einsum("ij,ij->i", matrix, errors)
        errors = new
        assert np.abs(errors / box).max() <= largest * (1 + 1e-12)
        largest = np.abs(errors / box).max()
    assert largest < 1e-3 * start


def test_condition_asks_for_links_that_recur_and_a_game_that_is_dominant():
    assert condition_on("energy-switching", field_laws.Routed).name.startswith("all links recur")
    assert not condition_on("energy-switching", field_laws.Routed).holds
    found = condition_on("energy-switching-transformed", field_laws.Routed)
    matrix = world_and_encoder("energy")[0].game.jacobian(np.zeros((5, 1)))[:, :, 0]
    assert found.name.startswith("ρ(D⁻¹")
    assert found.value == pytest.approx(theory.coupling_radius(matrix))
    assert condition_on("energy-switching-transformed", field_laws.Routed, step=0.6).name.startswith("η max")


def test_stamps_are_the_latest_instants_of_paths_that_respect_time():
    generator = np.random.default_rng(0)
    live = generator.random((12, 5, 5)) < 0.2
    live = (live | live.swapaxes(1, 2)) & ~np.eye(5, dtype=bool)
    found = stamps(live)
    for owner in range(5):
        for start in range(12):
            reached = np.eye(5, dtype=bool)[owner]
            for k in range(start, 12):
                assert (found[k, reached, owner] >= start).all()
                assert (found[k, ~reached, owner] < start).all()
                reached = reached | live[k][reached].any(axis=0)


def test_stamps_follow_their_recursion_where_players_have_no_links():
    live = np.random.default_rng(4).random((30, 7, 7)) > 0.9
    live = live | live.transpose(0, 2, 1)
    live[:, np.arange(7), np.arange(7)] = False
    live[[3, 9]] = False
    found = stamps(live)
    for k in range(29):
        for i in range(7):
            for o in range(7):
                heard = max([found[k, i, o], *(found[k, j, o] for j in np.flatnonzero(live[k, i]))])
                assert found[k + 1, i, o] == (k + 1 if o == i else heard)


def test_freshest_copies_are_those_of_the_stamps():
    """Each estimate is the strategy of its owner at the instant of its stamp, also over switching graphs."""
    world, states = episode(field_laws.Freshest, get_scenario("energy-switching", start="random", input_limit=1e5))
    live = np.stack([graph.adjacency > 0 for graph in world.topology.graphs])[world.modes]
    found = stamps(live)
    for k in (50, 133, 390):
        for i, o in np.ndindex(5, 5):
            if found[k, i, o] >= 0:
                assert states[k, o, i, 0] == pytest.approx(states[found[k, i, o], o, o, 0], abs=1e-4)


def test_laws_refuse_layouts_without_the_graphs_that_they_need():
    layout = world_and_encoder("energy")[1].layout
    with pytest.raises(LayoutError, match="does not hold the hop counts"):
        field_laws.Routed(layout)
    with pytest.raises(LayoutError, match="does not hold the links of every step"):
        field_laws.Freshest(layout)
    with pytest.raises(ValueError, match="step must be a finite number above 0"):
        field_laws.RoutedUnknown(layout, step=0.0)


def test_freshest_is_not_applicable_where_episodes_draw_their_schedules():
    results = run_suite("ptne-v1", ["freshest", "routed"], tracks=["markov"], episodes=2)
    assert "every episode draws its own" in results.not_applicable["markov", "freshest"]
    assert results.samples["markov", "routed"]["digits"].min() > 3


def test_learned_sources_are_those_of_the_graph_that_the_episode_drew():
    """The union of all graphs that may be drawn says nothing about the graph of an episode."""
    results = run_suite("ptne-v1", ["routed-unknown", "routed"], tracks=["unseen-graphs"], episodes=20)
    assert results.samples["unseen-graphs", "routed-unknown"]["digits"].min() > 11.9
    assert results.samples["unseen-graphs", "routed"]["digits"].max() < 1


def test_owner_is_the_only_source_from_the_first_meeting_on():
    """Player 0 first hears of component 1 through player 2, then meets player 1 itself, and then player 2 alone."""
    modes = [[(1, 2)], [(0, 2)], [(1, 2), (0, 2)], [(0, 1)], [(0, 2)], [(1, 2)]]
    graphs = tuple(FactorySpec.of("ptne_env.world.graphs:from_edges", players=3, edges=tuple(mode)) for mode in modes)
    topology = FactorySpec.of(
        "topology:periodic", graphs=graphs, dwells=(0.1,) * 6, clock="transformed"
    )
    scenario = affine_scenario(
        np.eye(3) + 0.1, np.ones(3), topology, spacing="transformed", s_end=20.0, input_limit=1e5
    )
    world, states = episode(field_laws.RoutedUnknown, scenario)
    for k, (before, after) in enumerate(zip(states[:, 1, :, 0], states[1:, 1, :, 0], strict=False)):
        links, met = modes[world.modes[k]], 3 in world.modes[: k + 1]
        if (0, 1) in links:
            assert after[0] == pytest.approx(before[1], abs=1e-5)
        elif met:
            assert after[0] == before[0]
        elif k > np.flatnonzero(world.modes == 2)[1]:
            assert after[0] == pytest.approx(before[2], abs=1e-5)


def test_news_that_never_move_reach_players_without_news():
    """Player 2 settles before player 0 meets player 1, whose copy of its strategy never moves again."""
    modes = [[(1, 2)], [(0, 1)]]
    graphs = tuple(FactorySpec.of("ptne_env.world.graphs:from_edges", players=3, edges=tuple(mode)) for mode in modes)
    topology = FactorySpec.of(
        "topology:periodic", graphs=graphs, dwells=(10.0, 10.0), clock="transformed"
    )
    scenario = affine_scenario(np.eye(3), np.ones(3), topology, spacing="transformed", s_end=20.0, input_limit=1e5)
    _, states = episode(field_laws.RoutedUnknown, scenario, step=1.0)
    assert states[-1, 2, 0, 0] == pytest.approx(states[-1, 2, 2, 0], abs=1e-4)


def test_strategies_at_rest_before_their_news_arrive_spoil_no_episode():
    """In the paper's game one strategy comes to rest before two players have heard of it."""
    scenarios = ["non-quadratic-switching", get_scenario("non-quadratic-switching", name="from the paper's start")]
    results = evaluate(["routed-unknown"], scenarios, episodes=10, seed=1, against_laws=False)
    assert len(results.samples) == 2
    assert min(samples["digits"].mean() for samples in results.samples.values()) > 6


def test_certificates_name_the_largest_stable_step():
    scenario, matrix, hops = random_fixed(0)
    assert (
        f"up to η = {theory.largest_delayed_step(matrix, hops):.3g}" in condition_on(scenario, field_laws.Routed).name
    )


def test_digits_on_switching_graphs_grow_with_knowledge():
    tracks = ["random-energy-switching", "random-energy-switching-transformed"]
    results = evaluate(["routed-unknown", "routed", "freshest"], tracks, episodes=300 if SOAK else 60, seed=87235)
    for track, bounds in zip(tracks, [(2.7, 3.7, 4.5), (6.5, 8.0, 9.5)], strict=True):
        means = [results.samples[track, name]["digits"].mean() for name in ("routed-unknown", "routed", "freshest")]
        assert all(mean >= bound for mean, bound in zip(means, bounds, strict=True)), means
