"""Fair opponents: laws tuned on the validation bank, against which learned policies are measured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

from ptne_env.experiments.policy_specs import PolicySpec
from ptne_env.factory import FactorySpec

GAINS = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0)
"""κ, and κ_ij(0), that are tried."""

ADAPTATION_RATES = (0.0, 0.003, 0.01)
"""γ that are tried."""

GRADIENT_GAINS = (1.0, 2.0, 3.0, 3.5, 4.0, 5.0)
"""Gradient gains that are tried."""

VALIDATION_EPISODES = 200

GROUPS = {"paper": "best of the paper's laws", "all": "best of all laws"}
"""Groups of laws, and the name under which the best of each stands in tables."""


def candidates(group: str) -> Iterator[FactorySpec]:
    """The laws of a group, as parts.

    ``"paper"``: static, adaptive and Corollary 1 with gradient gain 1. ``"all"``: these, static with other gradient
    gains, and grounded. The oracle and the null policy are in neither.

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


def best(digits: Sequence[float]) -> dict[str, PolicySpec]:
    """For each group, the law with the most digits; the first of equals wins.

    Args:
        digits: mean digits on the validation bank of each of ``candidates("all")``, in their order. The bank has 200
            episodes of seed 0, whatever the seed of the comparison.
    """
    found = dict(zip(candidates("all"), digits, strict=True))
    return {group: PolicySpec(name, max(candidates(group), key=found.__getitem__)) for group, name in GROUPS.items()}
