"""NashOpt: the problem of its README with the same costs and constraints, and the same equilibria to 1e-8.

The constraint is not active in the README's problem; with the limit 1 it is, and NashOpt finds the variational
equilibrium, whose multiplier is the price of the operator here. The law plays the game without the constraint.

Run it with: python examples/ecosystem/nashopt_equilibria.py
"""

import json

import jax
import jax.numpy as jnp
import numpy as np
from nashopt import GNEP

import ptne_env
from ptne_env.games import CostGame, price_constraint
from ptne_env.world.graphs import cycle

jax.config.update("jax_enable_x64", val=True)
SIZES = (2, 1, 1)


def costs(x: np.ndarray) -> list[np.ndarray]:
    """Return the costs of the three agents; of numpy's arrays (4, B), and of one point in JAX."""
    return [(x[0] - 1) ** 2 + (x[1] + 0.5) ** 2, (x[2] + 0.3) ** 2, (x[3] - 0.5 * (x[0] + x[2])) ** 2]


def total(x: np.ndarray) -> list[np.ndarray]:
    """Return what the shared constraint limits."""
    return [x[3] + x[0] + x[2]]


def main() -> None:
    """Solve the problem by both, at the README's limit and at one that is active."""
    game, difference = CostGame(costs, SIZES, 0.0, 1.0), 0.0
    for limit in (2.0, 1.0):
        theirs = GNEP(
            SIZES,
            f=[lambda x, i=i: costs(x)[i] for i in range(3)],
            g=lambda x, limit=limit: jnp.array(total(x)) - limit,
            ng=1,
            lb=np.zeros(4),
            ub=np.ones(4),
            variational=True,
        ).solve(tol=1e-14)
        ours = price_constraint(game, total, limit).nash_equilibrium
        print(f"limit {limit:g}: NashOpt {np.round(theirs.x, 6)}, ours {np.round(ours[:4], 6)}, price {ours[4]:.6f}")
        difference = max(difference, float(np.abs(theirs.x - ours[:4]).max()))
    assert difference <= 1e-8, difference  # noqa: S101 - what this example shows

    scenario = ptne_env.get_scenario("energy", name="readme", game=game, topology=cycle(3), start="random")
    digits = ptne_env.evaluate("static", scenario, episodes=4).record("readme", "static", "digits")["mean"]
    print(json.dumps({"what": "x* of its README", "law": digits, "difference": difference, "before": None}))


if __name__ == "__main__":
    main()
