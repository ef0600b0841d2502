"""Does a scenario meet what a law asks? The laws hold the conditions; ``theory`` holds the constants."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ptne_env.dynamics import Dynamics
from ptne_env.graphs import union
from ptne_env.interface import Interface, Port
from ptne_env.laws import Condition, Law, Premises
from ptne_env.laws.base import algebraic_connectivity
from ptne_env.parts import Part
from ptne_env.scenario import Scenario
from ptne_env.theory import closed_loop_matrix, monotonicity_constants


def premises(scenario: Scenario) -> Premises:
    """What conditions may ask of ``scenario``; for a family of games, of its representative member."""
    game, signal, clock = scenario.built_game, scenario.built_signal, scenario.built_clock
    constants = monotonicity_constants(game)
    n, players = game.dimension, game.num_players
    blocks = closed_loop_matrix(game, signal.graphs[0], 0.0).reshape(players, n, players, n)  # one row of dF each
    recurring = signal.union
    if not signal.is_fixed and signal.clock == "physical":
        last = signal.schedule(clock.signal_times["physical"][clock.steps - 1]).modes
        recurring = union([signal.graphs[int(last)]])
    return Premises(
        epsilon=constants.epsilon,
        iota_strategies=constants.iota_strategies,
        iota_estimates=constants.iota_estimates,
        exact=constants.exact,
        jacobian=np.einsum("icid->cd", blocks),
        owners=game.owners,
        laplacians=tuple(graph.laplacian for graph in signal.graphs),
        recurring_connectivity=algebraic_connectivity(recurring.laplacian),
        largest_step=float(np.max(clock.theta[: clock.steps])),
        effective_time=clock.effective_time,
        gain=clock.gain,
    )


def condition(law: Part | Callable[..., Law], scenario: Scenario) -> Condition | None:
    """Whether ``scenario`` meets the condition of a law, with the number that decides.

    Args:
        law: a law's class, or a part that builds one; called with ``layout=``.
        scenario: the experiment.

    Returns:
        The condition; ``None`` for laws that promise nothing.

    Raises:
        ValueError: when the law cannot act in the scenario.
    """
    target = law.resolve() if isinstance(law, Part) else law
    port = Port(Dynamics(scenario), getattr(target, "interface", Interface()))
    built = law.build(layout=port.layout) if isinstance(law, Part) else law(layout=port.layout)
    return built.condition(premises(scenario))
