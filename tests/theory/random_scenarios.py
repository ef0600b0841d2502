"""Random scenarios with a law, from well-behaved to unstable: every part of a certificate is asked for."""

import warnings
from dataclasses import dataclass

import numpy as np
from random_affine import graph_part, random_game

from ptne_env import FactorySpec, Scenario, theory
from ptne_env.theory.closed_loop import NoClosedLoopError
from ptne_env.world.world import World

LAWS = (
    ("Static", {"kappa": 3.0}),
    ("Static", {"kappa": 1.0, "gradient_gain": 0.5}),
    ("Grounded", {"kappa": 3.0}),
    ("CorollaryOne", {"kappa": 3.0}),
    ("FixedGain", {"kappa": 2.0}),
    ("Adaptive", {"gamma": 1e-4}),
    ("AdaptiveGrounded", {"gamma": 1e-4}),
)
S_ENDS = {
    ("exponential", "physical"): (1.0, 2.5),
    ("exponential", "effective"): (2.0, 12.0),
    ("exponential", "transformed"): (2.0, 12.0),
    ("rational", "physical"): (2.0, 12.0),
    ("rational", "effective"): (2.0, 80.0),
    ("rational", "transformed"): (2.0, 80.0),
    ("tanh", "physical"): (0.7, 1.5),
    ("tanh", "effective"): (1.0, 8.0),
    ("tanh", "transformed"): (1.0, 8.0),
}
"""Ranges of s_end by transformation and spacing."""


@dataclass(frozen=True)
class Drawn:
    """A scenario over perfect links, a law, and the noise and the delay that a certificate is asked about."""

    scenario: Scenario
    law: FactorySpec
    noise_std: float
    delay: int


def random_scenario(seed):
    """The scenario of a seed; its largest step is 0.3 to 3 times the largest stable step where there is one."""
    generator = np.random.default_rng([2014, seed])
    players = int(generator.integers(2, 6, endpoint=True))
    name, arguments = LAWS[generator.integers(len(LAWS))]
    law = FactorySpec.of(f"ptne_env.laws:{name}", **arguments)
    kind = str(generator.choice(["exponential", "rational", "tanh"]))
    spacing = str(generator.choice(["effective", "transformed", "physical"]))
    gains = [0.0, generator.uniform(0.0, 3.0), generator.uniform(3.0, 25.0)]
    gain = float(generator.choice(gains, p=[0.1, 0.45, 0.45]))
    scenario = Scenario(
        name=f"random-{seed}",
        game=random_game(generator, players, skew=3.0, epsilon=(0.1, 2.0), spread=(0.3, 4.0)),
        topology=FactorySpec.of("ptne_env.world.switching:fixed", graph=graph_part(generator, players)),
        start=FactorySpec.of("ptne_env.world.starts:UniformStart", low=-20.0, high=20.0),
        transformation=kind,
        spacing=spacing,
        deadline=float(generator.uniform(0.3, 3.0)),
        gain=gain,
        s_end=float(generator.uniform(*S_ENDS[kind, spacing])),
        steps=40,
        hold_steps=int(generator.choice([0, 10])) if gain > 0 else 0,
        input_limit=float(generator.choice([100.0, 1e6], p=[0.2, 0.8])),
    )
    scenario = scenario.replace(steps=_steps(scenario, law, float(np.exp(generator.uniform(*np.log([0.3, 3.0]))))))
    clock = generator.choice(["fixed", "physical", "transformed"], p=[0.7, 0.15, 0.15])
    if clock != "fixed" and players > 2:
        scenario = _switching(scenario, str(clock))
    return Drawn(scenario, law, float(generator.choice([0.0, 0.05])), int(generator.integers(0, 4)))


def quiet_world(scenario):
    """The world, without the warning that the last step ends early."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return World(scenario)


def _steps(scenario, law, margin):
    world = quiet_world(scenario)
    try:
        loop = theory.sampled_loop(world, theory.build_law(law, world))
    except NoClosedLoopError:
        return scenario.steps
    current = loop.step_margin()
    return scenario.steps if current is None else int(np.clip(np.ceil(scenario.steps * margin / current), 4, 400))


def _switching(scenario, clock):
    """The scenario over two graphs that take turns, each with every other link."""
    world = quiet_world(scenario)
    adjacency = world.topology.graphs[0].adjacency
    halves = np.zeros((2, *adjacency.shape))
    for edge, (i, j) in enumerate(np.argwhere(np.triu(adjacency))):
        halves[edge % 2, i, j] = halves[edge % 2, j, i] = adjacency[i, j]
    graphs = tuple(FactorySpec.of("ptne_env.world.graphs:Graph", adjacency=half) for half in halves)
    longest = np.diff(world.clock.topology_times[clock]).max()
    dwells = (2.5 * longest, 3.5 * longest)
    return scenario.replace(
        topology=FactorySpec.of("topology:periodic", graphs=graphs, dwells=dwells, clock=clock)
    )
