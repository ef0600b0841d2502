"""Affine games by their matrix, random strongly monotone ones, and the loop that runs a law on them."""

import os
from functools import cached_property

import numpy as np
from sample_games import AffineBlocks, times

from ptne_env import FactorySpec, Scenario
from ptne_env.world import dynamics

SOAK = bool(os.environ.get("PTNE_SOAK"))
"""Whether tests draw as many random cases as ``make soak`` asks for."""


class AffineGame(AffineBlocks):
    """F(x) = A x + q, one component per player; J_i = ½ A_ii x_i² + x_i (Σ_{j≠i} A_ij x_j + q_i)."""

    matrix: np.ndarray
    offset: np.ndarray

    def __post_init__(self):
        vars(self).update(matrix=np.array(self.matrix, dtype=float), offset=np.array(self.offset, dtype=float))
        super().__post_init__()

    @cached_property
    def action_dims(self):
        return (1,) * len(self.offset)

    def best_response(self, strategies):
        return strategies - (times(self.matrix, strategies) + self.offset[:, None]) / np.diag(self.matrix)[:, None]

    def _solve_nash_equilibria(self):
        return np.linalg.solve(self.matrix, -self.offset)[:, None]


def affine_scenario(matrix, offset, topology, **fields):
    """A scenario that plays F(x) = A x + q from random estimates."""
    game = FactorySpec.of("affine_games:AffineGame", matrix=matrix, offset=offset)
    return Scenario(name="affine", game=game, topology=topology, **{"start": "random", **fields})


def random_affine(generator, players, coupling=0.5):
    """A random strongly monotone matrix that is not symmetric, an offset and the adjacency of a random weighted graph
    that is connected."""
    matrix = generator.uniform(-coupling, coupling, (players, players)) + np.diag(generator.uniform(1, 3, players))
    matrix += max(0, 0.5 - np.linalg.eigvalsh(matrix + matrix.T)[0] / 2) * np.eye(players)
    adjacency = np.zeros((players, players))
    for i in range(1, players):
        j = generator.integers(i)
        adjacency[i, j] = adjacency[j, i] = generator.uniform(0.5, 1.5)
    extra = np.triu(generator.uniform(size=(players, players)) < 0.4, 1) * generator.uniform(0.5, 1.5)
    adjacency = np.maximum(adjacency, extra + extra.T)
    return matrix, generator.uniform(-5, 5, players), adjacency


def random_digraph(generator, players):
    """The adjacency of a random directed graph that is strongly connected: a ring in random order and other links."""
    order, adjacency = generator.permutation(players), generator.uniform(0.5, 1.5, (players, players))
    is_linked = generator.uniform(size=adjacency.shape) < 0.2
    is_linked[order, np.roll(order, 1)] = True
    return adjacency * is_linked * (1 - np.eye(players))


def run(world, encoder, law, start, steps=None):
    """All estimates of an episode, (K+1, n, N, B)."""
    state, memory, states = start, None, [start.estimates]
    for _ in range(steps or world.clock.steps):
        observations = encoder.observe(state).reshape(-1, encoder.layout.size)
        actions, memory = law.predict(observations, state=memory)
        actions = actions.reshape(dynamics.batch_size(state), encoder.layout.num_players, -1)
        state = dynamics.step(world, state, encoder.decode(actions, state))
        states.append(state.estimates)
    return np.array(states)


def loop_start(world, seed=0, size=20.0, batch=1):
    """A state with estimates drawn from U(−size, size)."""
    shape = (world.game.dimension, world.game.num_players, batch)
    return dynamics.initial_state(world, np.random.default_rng(seed).uniform(-size, size, shape))
