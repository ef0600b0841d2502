"""Define a congestion game by its costs alone: two routes whose travel times grow with their use.

Four fleets share a motorway and a road through the town. Each decides how many of its vehicles take the motorway, and
pays for the travel times of all its vehicles. The costs are written once; gradients, best responses and the equilibrium
follow from them.

Prints the equilibrium, the travel times at it, by how much a fleet could save alone, and the digits that the static law
reaches from random starts.

Run it with: python examples/congestion.py
"""

import numpy as np

import ptne_env
from ptne_env.games import CostGame
from ptne_env.world.graphs import cycle

FLEETS = np.array([[10.0], [20.0], [30.0], [40.0]])  # vehicles of each fleet


def travel_times(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the minutes on the motorway and through the town, (B,) each, where x (4, B) vehicles take the motorway."""
    motorway, town = x.sum(axis=0), (FLEETS - x).sum(axis=0)
    return 10 * (1 + 0.15 * (motorway / 40) ** 4), 20 * (1 + 0.15 * (town / 60) ** 4)


def costs(x: np.ndarray) -> np.ndarray:
    """Return the minutes that the vehicles of each fleet travel together, (4, B)."""
    motorway, town = travel_times(x)
    return x * motorway + (FLEETS - x) * town


def main() -> None:
    """Solve the game, and let players who hear only their neighbours seek the equilibrium."""
    game = CostGame(costs, action_dims=(1,) * 4, low=0.0, high=FLEETS.ravel())
    motorway, town = travel_times(game.nash_equilibria)
    print(f"on the motorway: {np.round(game.nash_equilibrium, 2)} of {FLEETS.ravel()} vehicles")
    print(f"minutes: motorway {motorway[0]:.2f}, town {town[0]:.2f}")
    print(f"no fleet can save more than {game.regrets(game.nash_equilibria).max():.0e} minutes alone")

    scenario = ptne_env.get_scenario("energy", name="congestion", game=game, topology=cycle(4), start="random")
    print(ptne_env.evaluate(["static", "grounded"], scenario, episodes=20))


if __name__ == "__main__":
    main()
