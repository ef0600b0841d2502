"""Tuned laws: the strongest laws of a grid on validation episodes, with which learned policies are compared."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product

from ptne_env.experiments.policy_specs import PolicySpec
from ptne_env.factory import FactorySpec
from ptne_env.observation import Interface

GAINS = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0)
"""κ, and κ_ij(0), of the grid."""

ADAPTATION_RATES = (0.0, 0.003, 0.01)
"""γ of the grid."""

GRADIENT_GAINS = (1.0, 2.0, 3.0, 3.5, 4.0, 5.0)
"""Gradient gains of the grid."""

VALIDATION_EPISODES = 200
"""Number of validation episodes, of seed 0 whatever the seed of the comparison."""

CANDIDATE = "candidate law"
"""Name of every candidate while it is tried."""

GROUPS = {"paper": "best of the paper's laws", "all": "best of all laws"}
"""Groups of laws, and the name under which the best of each stands in tables."""


def candidates(group: str) -> Iterator[FactorySpec]:
    """The laws of a group, as factory specs.

    ``"paper"``: static, adaptive and Corollary 1 with gradient gain 1. ``"all"``: these, static with other gradient
    gains, and grounded. The reference policies are in neither.

    Raises:
        ValueError: for another group.
    """
    if group not in GROUPS:
        raise ValueError(f"unknown group of laws {group!r}; choose from {', '.join(GROUPS)}")
    for gain in GAINS:
        yield FactorySpec.of("ptne_env.laws:Static", kappa=gain)
        yield FactorySpec.of("ptne_env.laws:CorollaryOne", kappa=gain)
    for gain, rate in product(GAINS, ADAPTATION_RATES):
        yield FactorySpec.of("ptne_env.laws:Adaptive", initial_gain=gain, gamma=rate)
    if group == "all":
        for gain in GAINS:
            yield FactorySpec.of("ptne_env.laws:Grounded", kappa=gain)
        for gain, gradient_gain in product(GAINS, GRADIENT_GAINS[1:]):
            yield FactorySpec.of("ptne_env.laws:Static", kappa=gain, gradient_gain=gradient_gain)


def candidate_specs() -> list[PolicySpec]:
    """All candidates as policies, in order."""
    return [PolicySpec(CANDIDATE, law, Interface()) for law in candidates("all")]


def best(digits: Mapping[FactorySpec, float]) -> dict[str, PolicySpec]:
    """For each group, the law with the most digits; the first of equals wins.

    Args:
        digits: mean digits on the validation episodes of every law of ``candidates("all")``.
    """
    return {group: PolicySpec(name, max(candidates(group), key=digits.__getitem__)) for group, name in GROUPS.items()}
