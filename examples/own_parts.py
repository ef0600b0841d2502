"""Define a game, a graph, a channel, a law and a track in a module of your own.

Nothing is registered: scenarios take objects or functions, and the command line names them as "own_parts:Name".

Run it with: python examples/own_parts.py
or, in the folder of this file: ptne compare --suite own_parts:suite --policy own_parts:HeavyBall --trust
"""

from dataclasses import replace
from functools import cached_property

import networkx as nx
import numpy as np
from rich.console import Console

from ptne_env import get_scenario, laws
from ptne_env.evaluation import Track
from ptne_env.games import AffineGame
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.report.terminal import result_tables
from ptne_env.suites import Suite, run_suite
from ptne_env.world import graphs, switching
from ptne_env.world.channels import Channel, LinkRandomness, Memory, Messages


class BeautyContest(AffineGame):
    """J_i(x) = ½ (x_i − r m_i − b_i)², where m_i is the mean of the others: players want to be close to each other."""

    tastes: tuple[float, ...] = (1.0, 2.0, 4.0, 8.0, 16.0)  # b_i
    conformity: float = 0.5  # r

    @cached_property
    def matrix(self) -> np.ndarray:
        """A of F(x) = A x + b."""
        players = len(self.tastes)
        return np.eye(players) - self.conformity / (players - 1) * (1 - np.eye(players))

    @cached_property
    def offset(self) -> np.ndarray:
        """The vector b of F(x) = A x + b."""
        return -np.array(self.tastes)


def wheel(players: int = 5) -> switching.SwitchingTopology:
    """Return a graph with player 0 in the hub and the others on the rim."""
    return switching.fixed(graphs.as_graph(nx.wheel_graph(players)))


class Clipped(Channel):
    """A channel that clips every number in messages to ±bound."""

    is_random = False

    bound: float

    def transmit(
        self,
        messages: Messages,
        memory: Memory | None,  # noqa: ARG002 - this channel keeps none
        randomness: LinkRandomness,  # noqa: ARG002 - this channel draws nothing
    ) -> tuple[Messages, Memory]:
        """Return the clipped messages."""
        return replace(messages, values=np.clip(messages.values, -self.bound, self.bound)), ()


class HeavyBall(laws.Law):
    """The static law with inertia: v ← β v + (1 − β) u, and v is the input."""

    def __init__(self, layout: ObservationLayout, kappa: float = 2.0, inertia: float = 0.5) -> None:
        """Store the consensus gain κ and the inertia β."""
        super().__init__(layout)
        self.kappa, self.inertia = kappa, inertia

    def initial_memory(self, rows: int) -> np.ndarray:
        """Return v = 0."""
        return np.zeros((rows, self.layout.dimension))

    def inputs(self, observation: Observation, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the input v, which is also the memory."""
        pull = np.einsum("rd,rdn->rn", observation.weights, observation.relative_estimates)
        memory = self.inertia * memory + (1 - self.inertia) * (self.kappa * pull - observation.gradient)
        return memory, memory


def suite() -> Suite:
    """Return a suite of two tracks: the game on the wheel, and the same with clipped messages."""
    base = get_scenario("energy", name="contest", game=BeautyContest(), topology=wheel, start="random")
    clipped = base.replace(name="clipped", channel=Clipped(bound=10.0))
    return Suite(
        "own-parts-v1",
        (Track("contest", base, "The base."), Track("clipped", clipped, "Numbers in messages are clipped to ±10.")),
        episodes=20,
    )


def main() -> None:
    """Compare the law above with the paper's on the suite above."""
    results = run_suite("own_parts:suite", ["own_parts:HeavyBall", "grounded"])
    Console(width=120).print(result_tables(results, width=120))


if __name__ == "__main__":
    main()
