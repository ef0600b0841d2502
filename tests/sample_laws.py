"""Laws that only the tests run, and the condition of a law on a scenario."""

import numpy as np

from ptne_env import FactorySpec, get_scenario, theory
from ptne_env.laws import Law, Static
from ptne_env.world.world import World


class Damped(Static):
    """The static law divided by 1 + Θ/T + Δt/T, so that every step has a loop of its own."""

    def inputs(self, observation, memory):
        inputs, memory = super().inputs(observation, memory)
        return inputs / (1 + (observation.theta + observation.dt) / self.layout.deadline), memory


class Sign(Law):
    """u = −sign of the gradient."""

    def inputs(self, observation, memory):
        return -np.sign(observation.gradient), memory


def spec_of(law, **arguments):
    """The spec of a law of the library, by class or id."""
    return FactorySpec.of(law, **arguments)


def condition_on(scenario, law, **arguments):
    """The condition of a law of the library on a scenario, by class or id."""
    world = World(get_scenario(scenario))
    return theory.condition(theory.build_law(spec_of(law, **arguments), world), theory.problem_constants(world))
