"""Define a game by its costs, predict how a law does on it, and evaluate the law.

Prints whether Assumption 3 of the paper holds on samples, the Nash equilibrium, the monotonicity and Lipschitz
constants ε and ι, whether the static law's gain condition holds at two gains κ with the decay rate that the theory
predicts for each, and the digits that the law reaches from 50 random starts.

Run it with: python examples/custom_game.py
"""

from functools import cached_property

import numpy as np

import ptne_env
from ptne_env import FactorySpec, get_scenario, theory
from ptne_env.games import CostGame

Array = np.ndarray


class Fashion(CostGame):
    """J_i(x) = (x_i − b_i)² + sqrt(1 + (x_i − m_i)²), taste and fashion, where m_i is the mean of the others.

    Arrays have environments last, (n, B). Gradients, best responses and the equilibrium follow from the costs.

    Attributes:
        taste: the taste b_i of each player.
    """

    taste: tuple[float, ...] = (2.0, 4.0, 6.0, 8.0, 10.0)

    @cached_property
    def action_dims(self) -> tuple[int, ...]:
        """One component per player."""
        return (1,) * len(self.taste)

    @cached_property
    def tastes(self) -> Array:
        """The tastes b_i, shape (n, 1)."""
        return np.array(self.taste)[:, None]

    def costs(self, strategies: Array) -> Array:
        """Return J_i, shape (N, B), at strategies of shape (n, B)."""
        return (strategies - self.tastes) ** 2 + np.sqrt(1 + (strategies - self._means(strategies)) ** 2)

    def _means(self, strategies: Array) -> Array:
        return (strategies.sum(axis=0) - strategies) / (self.num_players - 1)


def main() -> None:
    """Check the game, certify the static law on it at two gains, and evaluate it."""
    game = Fashion()
    print(f"Assumption 3 on samples: {np.all(theory.check_costs(game))}")
    regret = np.abs(game.regrets(game.nash_equilibria)).max()
    print(f"x* = {np.round(game.nash_equilibrium, 4)}; no player can lower its own cost by more than {regret:.0e}")

    scenario = get_scenario("energy", name="fashion", game="custom_game:Fashion", start="random")
    constants = theory.monotonicity_constants(game)
    print(f"ε = {constants.epsilon:.3f}, ι = {constants.iota:.3f}")
    for kappa in (2.0, 10.0):
        certificate = theory.certify(scenario, FactorySpec.of("law:static", kappa=kappa))
        condition = certificate.condition
        verdict = "holds" if condition.holds else "fails"
        print(
            f"κ = {kappa:g}: {condition.name}: {condition.value:.3g} against {condition.bound:.3g}, {verdict}; "
            f"rate near x* {certificate.rate:.3f}"
        )
    results = ptne_env.evaluate(["static"], [scenario], episodes=50)
    digits = results.record("fashion", "static", "digits")
    print(f"static law, κ = 2: {digits['mean']:.2f} digits [{digits['low']:.2f}, {digits['high']:.2f}]")


if __name__ == "__main__":
    main()
