"""Random affine scenarios, strongly monotone games on connected graphs, with a law and its episodes."""

import warnings
from dataclasses import dataclass

import networkx as nx
import numpy as np

from ptne_env import FactorySpec, Scenario, theory
from ptne_env.evaluation.rollout import rollout
from ptne_env.perception.encoder import Encoder, make_encoder
from ptne_env.perception.observation import Interface
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.theory.closed_loop import blank_observation
from ptne_env.world import dynamics
from ptne_env.world.distances import estimate_distance
from ptne_env.world.world import World

BATCH = 2
"""Starts per scenario, played in one batch: one anywhere, and one that leans towards the slowest mode."""


@dataclass
class Case:
    spec: FactorySpec
    law: object
    encoder: Encoder
    starts: np.ndarray  # (n, N, BATCH)

    @property
    def world(self):
        return self.encoder.world

    @property
    def scenario(self):
        return self.world.scenario

    @property
    def game(self):
        return self.world.game

    @property
    def loop(self):
        return theory.sampled_loop(self.world, self.law)

    def play(self):
        return rollout(self.law, self.encoder, dynamics.initial_state(self.world, self.starts))

    def switch(self, clock):
        """Make the graph switch between its two halves, each disconnected, on ``clock``."""
        adjacency = self.world.topology.graphs[0].adjacency
        halves = [np.zeros_like(adjacency), np.zeros_like(adjacency)]
        for edge, (i, j) in enumerate(np.argwhere(np.triu(adjacency))):
            halves[edge % 2][i, j] = halves[edge % 2][j, i] = adjacency[i, j]
        graphs = tuple(FactorySpec.of("ptne_env.world.graphs:Graph", adjacency=half) for half in halves)
        longest = np.diff(self.world.clock.topology_times[clock]).max()
        dwells = (2.5 * longest, 3.5 * longest)
        topology = FactorySpec.of("topology:periodic", graphs=graphs, dwells=dwells, clock=clock)
        self.encoder = encoder_of(self.scenario.replace(topology=topology))
        self.law = theory.build_law(self.spec, self.world)

    def play_in_float64(self):
        """An episode in the environment's own world, with float64 observations of the law.

        Estimate distances (K+H+1, BATCH), and the root mean square of the velocity Θ u/Δt over a step, (K+H, BATCH).
        """
        world, distances, velocities = self.world, [], []
        state, (n, players) = dynamics.initial_state(world, self.starts), self.starts.shape[:2]
        rows = players * BATCH
        blank = blank_observation(self.encoder.layout, np.repeat(np.arange(players), BATCH))
        own, memory = self.encoder.layout.own_mask[blank.player], self.law.initial_memory(rows)
        for theta, dt in zip(world.clock.theta[:-1], world.clock.dt[:-1], strict=True):
            distances.append(estimate_distance(state.estimates, state.game))
            weights = dynamics.weights(world, state)
            differences = dynamics.relative_estimates(world, state)
            observation = blank._replace(
                gradient=np.where(own, np.tile(state.own_gradients.T, (players, 1)), 0.0),
                relative_estimates=differences.transpose(2, 3, 0, 1).reshape(rows, -1, n),
                weights=np.broadcast_to(weights, (*weights.shape[:2], BATCH)).transpose(1, 2, 0).reshape(rows, -1),
                theta=np.full((rows, 1), theta),
                dt=np.full((rows, 1), dt),
            )
            inputs, memory = self.law.inputs(observation, memory)
            inputs = inputs.reshape(players, BATCH, n).transpose(2, 0, 1)
            velocities.append(theta / dt * np.sqrt((inputs**2).mean(axis=(0, 1))))
            state = dynamics.step(world, state, inputs)
        distances.append(estimate_distance(state.estimates, state.game))
        return np.array(distances), np.array(velocities)

    def play_over_channel(self, starts, noise_std=0.0, delay=0, follow=None):
        """Estimate distances (K+1, B) over a channel with noise and constant delay.

        With ``follow``, a vector of the stacked estimates, the size of the error's component along it.
        """
        stages = [FactorySpec.of("ptne_env.world.channel:Delay", steps=delay)] if delay else []
        stages += [FactorySpec.of("ptne_env.world.channel:AdditiveNoise", std=noise_std)] if noise_std else []
        channel = FactorySpec.of("ptne_env.world.channel:Chain", stages=tuple(stages))
        encoder = encoder_of(self.scenario.replace(channel=channel))
        world, path, memory, batch = encoder.world, [], None, starts.shape[2]
        randomness = world.draw_randomness([RandomStreams.from_seed(seed) for seed in range(batch)])
        state = dynamics.initial_state(world, starts, randomness=randomness)

        def measure(state):
            if follow is None:
                return estimate_distance(state.estimates, state.game)
            errors = state.estimates - state.game.nash_equilibria[:, None]
            return np.abs(follow @ errors.transpose(1, 0, 2).reshape(-1, errors.shape[2]))

        for _ in range(world.clock.steps):
            path.append(measure(state))
            observations = encoder.observe(state)
            actions, memory = self.law.predict(observations.reshape(-1, observations.shape[-1]), memory)
            state = dynamics.step(world, state, encoder.decode(actions.reshape(*observations.shape[:2], -1), state))
        path.append(measure(state))
        return np.array(path)

    def start_errors(self):
        return [theory.start_error(self.starts[:, :, b], self.game) for b in range(BATCH)]


def graph_part(generator, players):
    """A random tree and a few more edges, with weights between 0.5 and 1.5."""
    tree = nx.random_labeled_tree(players, seed=int(generator.integers(1 << 31)))
    adjacency = nx.to_numpy_array(tree) + (generator.random((players, players)) < 0.2)
    adjacency = np.triu((adjacency + adjacency.T > 0) * generator.uniform(0.5, 1.5, (players, players)), 1)
    return FactorySpec.of("ptne_env.world.graphs:Graph", adjacency=adjacency + adjacency.T)


def random_game(generator, players, skew, epsilon, spread):
    return FactorySpec.of(
        "sample_games:AffineGame",
        action_dims=generator.choice([1, 1, 1, 2], players),
        epsilon=float(generator.uniform(*epsilon)),
        spread=float(generator.uniform(*spread)),
        skew=float(generator.uniform(0.0, skew)),
        seed=int(generator.integers(1 << 31)),
    )


def encoder_of(scenario):
    """The encoder of the default interface, without the warning that evenly spaced steps in t end early."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return make_encoder(World(scenario), Interface("physical"))


def slowest_mode(matrix):
    """The real part of the eigenvector whose eigenvalue has the smallest real part, its largest entry being ±1."""
    eigenvalues, vectors = np.linalg.eig(matrix)
    mode = vectors[:, eigenvalues.real.argmin()].real
    return mode / np.abs(mode).max()


def random_case(
    seed,
    law="Static",
    margin=(1.05, 1.8),
    players=(3, 8),
    skew=1.5,
    epsilon=(0.3, 2.0),
    spread=(0.5, 4.0),
    kappa=(-1, 3),
    **fields,
):
    """A scenario whose steps are short enough by a random factor in ``margin``, with a law of random gains."""
    generator = np.random.default_rng([20, seed])
    players = int(generator.integers(*players, endpoint=True))
    arguments = {"kappa": float(2 ** generator.uniform(*kappa))} if law != "Adaptive" else {"gamma": 1e-4}
    if law == "Static":
        arguments["gradient_gain"] = float(2 ** generator.uniform(-1, 1))
    spacing = str(generator.choice(["effective", "transformed", "physical"], p=[0.5, 0.25, 0.25]))
    spacing = fields.get("spacing", spacing)
    values = {
        "name": f"random-{seed}",
        "game": random_game(generator, players, skew, epsilon, spread),
        "topology": FactorySpec.of("ptne_env.world.switching:fixed", graph=graph_part(generator, players)),
        "start": "random",
        "deadline": float(generator.uniform(0.5, 2.5)),
        "gain": float(generator.uniform(0.0, 2.0 if spacing == "transformed" else 25.0)),
        "s_end": float(generator.uniform(1.8, 2.5) if spacing == "physical" else generator.uniform(4.7, 12.0)),
        "spacing": spacing,
        "input_limit": 1e6,
        **fields,
    }
    rough = encoder_of(Scenario(**values)).world
    spec = FactorySpec.of(f"ptne_env.laws:{law}", **arguments)
    built = theory.build_law(spec, rough)
    loop = theory.sampled_loop(rough, built)
    longest = loop.steps[: rough.clock.steps].max()
    stable = theory.largest_stable_step(loop.loops[0].matrix)
    if stable is None:
        raise ValueError(f"the loop of random case {seed} is unstable at every step: raise κ or lower the skew")
    steps = max(20, int(np.ceil(rough.clock.steps * longest / stable * generator.uniform(*margin))))
    encoder = encoder_of(rough.scenario.replace(steps=steps))
    game = encoder.world.game
    starts = generator.uniform(-20, 20, (game.dimension, players, BATCH))
    slowest = slowest_mode(loop.loops[0].matrix).reshape(players, game.dimension).T
    starts[:, :, 1] = game.nash_equilibrium[:, None] + 10 * slowest + 0.02 * starts[:, :, 1]
    return Case(spec, built, encoder, starts)
