"""Does a scenario meet what a law asks? The laws hold the conditions of their theorems; here are the numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ptne_env.dynamics import Dynamics
from ptne_env.interface import Interface, Port
from ptne_env.laws import Condition, Law, Premises
from ptne_env.laws.base import algebraic_connectivity
from ptne_env.parts import Part
from ptne_env.scenario import Scenario
from ptne_env.theory.closed_loop import last_modes
from ptne_env.theory.constants import MonotonicityConstants, jacobians, monotonicity_constants


def premises(scenario: Scenario, constants: MonotonicityConstants | None = None) -> Premises:
    """What conditions may ask of ``scenario``; for a family of games, of its representative member.

    Args:
        scenario: the experiment.
        constants: of its game, when already known.
    """
    game, signal, clock = scenario.built_game, scenario.built_signal, scenario.built_clock
    constants = constants or monotonicity_constants(game)
    recurring = [signal.union]
    if not signal.is_fixed and signal.clock == "physical":  # one mode is the last before T
        recurring = [signal.graphs[mode] for mode in last_modes(signal, scenario.deadline)]
    return Premises(
        epsilon=constants.epsilon,
        iota_strategies=constants.iota_strategies,
        iota_estimates=constants.iota_estimates,
        exact=constants.exact,
        jacobian=jacobians(game, game.nash_equilibrium[:, None])[:, :, 0],
        owners=game.owners,
        laplacians=tuple(graph.laplacian for graph in signal.graphs),
        recurring_connectivity=min(algebraic_connectivity(graph.laplacian) for graph in recurring),
        largest_step=float(np.max(clock.theta[: clock.steps])),
        effective_time=clock.effective_time,
        gain=clock.gain,
    )


def build_law(law: Part | Callable[..., Law], scenario: Scenario) -> Law:
    """The law, built for the scenario's layout under the interface through which it acts.

    Args:
        law: a law's class, or a part that builds one; called with ``layout=``.
        scenario: the experiment.

    Raises:
        ValueError: when the law cannot act in the scenario, or what is built is no law.
    """
    target = law.resolve() if isinstance(law, Part) else law
    port = Port(Dynamics(scenario), getattr(target, "interface", Interface()))
    built = law.build(layout=port.layout) if isinstance(law, Part) else law(layout=port.layout)
    if not isinstance(built, Law):
        raise ValueError(f"{law!r} built a {type(built).__name__}; the theory is about a ptne_env.laws.Law")
    return built


def condition(law: Part | Callable[..., Law], scenario: Scenario) -> Condition | None:
    """Whether ``scenario`` meets the condition of a law, with the number that decides.

    Args:
        law: a law's class, or a part that builds one; called with ``layout=``.
        scenario: the experiment.

    Returns:
        The condition; ``None`` for laws that promise nothing.

    Raises:
        ValueError: as :func:`build_law`.
    """
    return build_law(law, scenario).condition(premises(scenario))
