"""Does a scenario meet what a law asks? The laws hold the conditions of their theorems; here are the numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ptne_env.encoder import make_encoder
from ptne_env.factory import FactorySpec
from ptne_env.laws import Condition, Law, ProblemConstants
from ptne_env.laws.base import algebraic_connectivity
from ptne_env.observation import Interface
from ptne_env.scenario import Scenario
from ptne_env.theory.closed_loop import last_modes
from ptne_env.theory.constants import MonotonicityConstants, jacobians, monotonicity_constants
from ptne_env.world import World


def problem_constants(scenario: Scenario, constants: MonotonicityConstants | None = None) -> ProblemConstants:
    """What conditions may ask of ``scenario``; for a family of games, of its representative member.

    Args:
        scenario: the experiment.
        constants: of its game, when already known.
    """
    game, topology, clock = World(scenario).game, World(scenario).topology, World(scenario).clock
    constants = constants or monotonicity_constants(game)
    recurring = [topology.union]
    if not topology.is_fixed and topology.clock == "physical":  # one mode is the last before T
        recurring = [topology.graphs[mode] for mode in last_modes(topology, scenario.deadline)]
    return ProblemConstants(
        epsilon=constants.epsilon,
        iota_strategies=constants.iota_strategies,
        iota_estimates=constants.iota_estimates,
        exact=constants.exact,
        jacobian=jacobians(game, game.nash_equilibrium[:, None])[:, :, 0],
        owners=game.owners,
        laplacians=tuple(graph.laplacian for graph in topology.graphs),
        recurring_connectivity=min(algebraic_connectivity(graph.laplacian) for graph in recurring),
        largest_step=float(np.max(clock.theta[: clock.steps])),
        effective_time=clock.effective_time,
        gain=clock.gain,
    )


def build_law(law: FactorySpec | Callable[..., Law], scenario: Scenario) -> Law:
    """The law, built for the scenario's layout under the interface through which it acts.

    Args:
        law: a law's class, or a part that builds one; called with ``layout=``.
        scenario: the experiment.

    Raises:
        ValueError: when the law cannot act in the scenario, or what is built is no law.
    """
    target = law.resolve() if isinstance(law, FactorySpec) else law
    encoder = make_encoder(World(scenario), getattr(target, "interface", Interface()))
    built = law.build(layout=encoder.layout) if isinstance(law, FactorySpec) else law(layout=encoder.layout)
    if not isinstance(built, Law):
        raise ValueError(f"{law!r} built a {type(built).__name__}; the theory is about a ptne_env.laws.Law")
    return built


def condition(law: FactorySpec | Callable[..., Law], scenario: Scenario) -> Condition | None:
    """Whether ``scenario`` meets the condition of a law, with the number that decides.

    Args:
        law: a law's class, or a part that builds one; called with ``layout=``.
        scenario: the experiment.

    Returns:
        The condition; ``None`` for laws that promise nothing.

    Raises:
        ValueError: as :func:`build_law`.
    """
    return build_law(law, scenario).condition(problem_constants(scenario))
