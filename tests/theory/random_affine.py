"""Random affine scenarios: strongly monotone games on connected graphs, and what a law does on them."""

import warnings
from dataclasses import dataclass

import networkx as nx
import numpy as np

from ptne_env import Part, Scenario, theory
from ptne_env.distances import estimate_distance
from ptne_env.dynamics import Dynamics
from ptne_env.evaluation.rollout import rollout
from ptne_env.interface import Interface, Port
from ptne_env.theory.closed_loop import blank_reading

BATCH = 2
"""Starts per scenario, played in one batch: one anywhere, and one that leans towards the slowest mode."""


@dataclass
class Case:
    scenario: Scenario
    law: object
    port: Port
    starts: np.ndarray  # (n, N, BATCH)

    def play(self):
        dynamics = self.port.dynamics
        return rollout(self.law, self.port, dynamics.start(self.starts))

    def play_in_float64(self):
        """Estimate distances (K+1, BATCH) of the law in the environment's own dynamics, seeing more than float32."""
        dynamics, path, memory = self.port.dynamics, [], None
        state, (n, players) = dynamics.start(self.starts), self.starts.shape[:2]
        blank = blank_reading(self.port.layout, np.repeat(np.arange(players), BATCH))
        own = self.port.layout.own_mask[blank.player]
        for theta, dt in zip(dynamics.clock.theta[:-1], dynamics.clock.dt[:-1], strict=True):
            path.append(estimate_distance(state.estimates, state.game))
            relative = state.relative_estimates.transpose(2, 3, 0, 1)
            weights = np.broadcast_to(state.weights, (*state.weights.shape[:2], BATCH)).transpose(1, 2, 0)
            reading = blank._replace(
                gradient=np.where(own, np.tile(state.own_gradients.T, (players, 1)), 0.0),
                relative_estimates=relative.reshape(players * BATCH, -1, n),
                weights=weights.reshape(players * BATCH, -1),
                theta=np.full((players * BATCH, 1), theta),
                dt=np.full((players * BATCH, 1), dt),
            )
            inputs, memory = self.law.inputs(reading, memory)
            state = dynamics.step(state, inputs.reshape(players, BATCH, n).transpose(2, 0, 1))
        path.append(estimate_distance(state.estimates, state.game))
        return np.array(path)

    def play_over_channel(self, starts, noise_std=0.0, delay=0, seed=0, follow=None):
        """Estimate distances (K+1, B) when messages carry noise and arrive ``delay`` steps late.

        With ``follow``, a vector of the stacked estimates, the size of the error's component along it.
        """
        dynamics, layout, generator = self.port.dynamics, self.port.layout, np.random.default_rng(seed)
        part = layout.slices["relative_estimates"]
        neighbours = np.array(layout.neighbours)
        live = np.array(neighbours != np.arange(len(neighbours))[:, None])[:, :, None]
        state, sent, path, memory = dynamics.start(starts), [], [], None

        def measure(state):
            if follow is None:
                return estimate_distance(state.estimates, state.game)
            errors = state.estimates - state.game.nash_equilibria[:, None]
            return np.abs(follow @ errors.transpose(1, 0, 2).reshape(-1, errors.shape[2]))

        for _ in range(dynamics.clock.steps):
            path.append(measure(state))
            sent.append(state.estimates.transpose(2, 1, 0))  # (B, N, n)
            messages = sent[max(len(sent) - 1 - delay, 0)][:, neighbours]  # (B, N, D, n)
            messages = messages + noise_std * generator.normal(size=messages.shape)
            observations = self.port.observe(state)
            relative = (messages - sent[-1][:, :, None]) * live
            observations[:, :, part] = relative.reshape(*relative.shape[:2], -1)
            actions, memory = self.law.predict(observations.reshape(-1, layout.size), memory)
            actions = actions.reshape(*observations.shape[:2], -1)
            state = dynamics.step(state, self.port.decode(actions, state).inputs)
        path.append(measure(state))
        return np.array(path)

    def start_errors(self):
        game = self.scenario.built_game
        return [theory.start_error(self.starts[:, :, b], game) for b in range(BATCH)]


def graph_part(generator, players):
    """A random tree and a few more edges, with weights between 0.5 and 1.5."""
    tree = nx.random_labeled_tree(players, seed=int(generator.integers(1 << 31)))
    adjacency = nx.to_numpy_array(tree) + (generator.random((players, players)) < 0.2)
    adjacency = np.triu((adjacency + adjacency.T > 0) * generator.uniform(0.5, 1.5, (players, players)), 1)
    return Part.of("ptne_env.graphs:Graph", adjacency=adjacency + adjacency.T)


def random_game(generator, players, skew, epsilon, spread):
    return Part.of(
        "sample_games:AffineGame",
        action_dims=generator.choice([1, 1, 1, 2], players),
        epsilon=float(generator.uniform(*epsilon)),
        spread=float(generator.uniform(*spread)),
        skew=float(generator.uniform(0.0, skew)),
        seed=int(generator.integers(1 << 31)),
    )


def quietly(**fields):
    """The scenario, without the warning that evenly spaced steps in t end early."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Scenario(**fields)


def slowest_mode(matrix):
    """The real part of the eigenvector whose eigenvalue has the smallest real part, its largest entry being ±1."""
    eigenvalues, vectors = np.linalg.eig(matrix)
    mode = vectors[:, eigenvalues.real.argmin()].real
    return mode / np.abs(mode).max()


def random_case(
    seed, law="Static", margin=(1.05, 1.8), players=(3, 8), skew=1.5, epsilon=(0.3, 2.0), spread=(0.5, 4.0), **fields
):
    """A scenario whose steps are short enough by a random factor in ``margin``, with a law of random gains."""
    generator = np.random.default_rng([20, seed])
    players = int(generator.integers(*players, endpoint=True))
    arguments = {"kappa": float(2 ** generator.uniform(-1, 3))} if law != "Adaptive" else {"gamma": 1e-4}
    if law == "Static":
        arguments["gradient_gain"] = float(2 ** generator.uniform(-1, 1))
    spacing = str(generator.choice(["effective", "transformed", "physical"], p=[0.5, 0.25, 0.25]))
    spacing = fields.get("spacing", spacing)
    values = {
        "name": f"random-{seed}",
        "game": random_game(generator, players, skew, epsilon, spread),
        "signal": Part.of("ptne_env.graphs:fixed", graph=graph_part(generator, players)),
        "start": "random",
        "deadline": float(generator.uniform(0.5, 2.5)),
        "gain": float(generator.uniform(0.0, 2.0 if spacing == "transformed" else 25.0)),
        "s_end": float(generator.uniform(1.8, 2.5) if spacing == "physical" else generator.uniform(4.7, 12.0)),
        "spacing": spacing,
        "input_limit": 1e6,
        **fields,
    }
    rough = quietly(**values)
    built = theory.build_law(Part.of(f"ptne_env.laws:{law}", **arguments), rough)
    loop = theory.sampled_loop(rough, built)
    longest = loop.steps[: rough.steps].max()
    stable = theory.largest_stable_step(loop.loops[0].matrix)
    if stable is None:
        raise ValueError(f"the loop of random case {seed} is unstable at every step: raise κ or lower the skew")
    steps = max(20, int(np.ceil(rough.steps * longest / stable * generator.uniform(*margin))))
    scenario = quietly(**{**values, "steps": steps})
    port = Port(Dynamics(scenario), Interface())
    game = port.dynamics.game
    starts = generator.uniform(-20, 20, (game.dimension, players, BATCH))
    slowest = slowest_mode(loop.loops[0].matrix).reshape(players, game.dimension).T
    starts[:, :, 1] = game.nash_equilibrium[:, None] + 10 * slowest + 0.02 * starts[:, :, 1]
    return Case(scenario, built, port, starts)
