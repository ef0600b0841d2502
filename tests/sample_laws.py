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


class Late(Static):
    """The static law with a gradient gain that grows from 1 to 3 until the deadline."""

    def inputs(self, observation, memory):
        inputs, memory = super().inputs(observation, memory)
        return inputs - 2 * observation.elapsed * observation.gradient, memory


class Gated(Static):
    """The static law, which rests until s = 2."""

    def inputs(self, observation, memory):
        inputs, memory = super().inputs(observation, memory)
        return inputs * (observation.transformed > 2), memory


class Saturating(Static):
    """The static law within ±5."""

    def inputs(self, observation, memory):
        inputs, memory = super().inputs(observation, memory)
        return np.clip(inputs, -5, 5), memory


class Rewritten(Static):
    """The static law, which writes half of its inputs into its actions."""

    def decide(self, rows, memory, starts, *, deterministic):
        actions, memory = super().decide(rows, memory, starts, deterministic=deterministic)
        return actions / 2, memory


class DeadZone(Static):
    """The static law, which ignores what is below 1e-3."""

    def inputs(self, observation, memory):
        inputs, memory = super().inputs(observation, memory)
        return inputs * (np.abs(inputs) > 1e-3), memory


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
