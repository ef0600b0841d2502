"""Proximal best response: its iteration, its condition, and the digits that it reaches."""

from itertools import pairwise

import numpy as np
import pytest
from affine_games import SOAK, affine_scenario, loop_start, random_affine, run
from worlds import channel_part, fixed_part

from ptne_env import Interface, evaluate, get_scenario, laws
from ptne_env.perception.encoder import Encoder
from ptne_env.world.world import World


def played(world, steps=None, **arguments):
    """Estimates of an episode, (K+1, n, N)."""
    encoder = Encoder(world, laws.ProximalBestResponse.interface)
    return run(world, encoder, laws.ProximalBestResponse(encoder.layout, **arguments), loop_start(world), steps)[..., 0]


def proximal_point(jacobian, offset, owners, adjacency, estimates, step, mixing):
    """One iteration of the paper with known costs: (n, N) to (n, N)."""
    laplacian = np.diag(adjacency.sum(axis=1)) - adjacency
    mixed = estimates @ (np.eye(len(adjacency)) - mixing * laplacian).T
    following = (estimates + mixed) / 2
    for player in range(len(adjacency)):
        own = owners == player
        block = jacobian[np.ix_(own, own)]
        others = jacobian[np.ix_(own, ~own)] @ following[~own, player] + offset[own]
        right = estimates[own, player] + mixed[own, player] - step * others
        following[own, player] = np.linalg.solve(2 * np.eye(own.sum()) + step * block, right)
    return following


@pytest.mark.parametrize("seed", range(2))
def test_iteration_is_the_proximal_point_once_rows_are_identified(seed):
    matrix, offset, adjacency = random_affine(np.random.default_rng(seed), 4)
    mixing = 0.9 / adjacency.sum(axis=1).max()
    world = World(affine_scenario(matrix, offset, fixed_part(adjacency)))
    states = played(world, 60, step=1.0, mixing=mixing)
    gaps = [
        np.linalg.norm(proximal_point(matrix, offset, np.arange(4), adjacency, now, 1.0, mixing) - following)
        / np.linalg.norm(following - now)
        for now, following in pairwise(states[25:41])
    ]
    assert max(gaps) < 1e-2
    fixed = proximal_point(
        matrix, offset, np.arange(4), adjacency, np.tile(world.game.nash_equilibria, (1, 4)), 1.0, mixing
    )
    assert fixed == pytest.approx(np.tile(world.game.nash_equilibria, (1, 4)), abs=1e-10)


def test_players_with_several_components_solve_for_their_block():
    world = World(get_scenario("robots"))
    game = world.game
    adjacency = world.topology.graphs[0].adjacency
    states = played(world, 60, step=1.0, mixing=0.3)
    jacobian, offset = game.matrices[..., 0], game.offsets[:, 0]
    expected = proximal_point(jacobian, offset, game.owners, adjacency, states[50], 1.0, 0.3)
    assert np.linalg.norm(expected - states[51]) < 1e-2 * np.linalg.norm(states[51] - states[50])


def test_trust_region_keeps_steps_short_where_gradients_are_not_affine():
    results = evaluate(["proximal-best-response"], ["non-quadratic"], episodes=40 if SOAK else 8)
    samples = results.samples["non-quadratic", "proximal-best-response"]
    assert not samples["diverged_share"].any()
    assert samples["digits"].mean() > 10


def test_law_reaches_many_digits_and_does_not_diverge():
    lossy = get_scenario("random-energy", name="lossy", channel=channel_part("Loss", probability=0.3))
    scenarios = [get_scenario("random-energy"), get_scenario("random-affine"), lossy]
    results = evaluate(["grounded", "proximal-best-response"], scenarios, episodes=5)
    digits = {
        (name, law): results.samples[name, law]["digits"]
        for name in ("random-energy", "random-affine", "lossy")
        for law in ("grounded", "proximal-best-response")
    }
    assert digits["random-energy", "proximal-best-response"].min() > 11
    assert digits["random-affine", "proximal-best-response"].mean() > digits["random-affine", "grounded"].mean()
    assert digits["lossy", "proximal-best-response"].min() > 6


def test_wrong_numbers_and_interfaces_are_named():
    world = World(get_scenario("energy"))
    layout = Encoder(world, Interface("physical")).layout
    for name in ("step", "mixing", "spread"):
        with pytest.raises(ValueError, match=f"{name} must be"):
            laws.ProximalBestResponse(layout, **{name: 0.0})
    with pytest.raises(ValueError, match="reads own_estimate"):
        laws.ProximalBestResponse(Encoder(world, Interface("scaled")).layout)
