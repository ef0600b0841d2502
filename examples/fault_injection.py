"""Measure a law when messages are lost, late or noisy, when strategies are pushed, and when inputs saturate.

Prints the digits of the paper's static law at the deadline as each fault grows alone, and then under several at once,
over 30 episodes with the same games and starts.

Run it with: python examples/fault_injection.py
"""

from typing import Any

import ptne_env
from ptne_env import FactorySpec, get_scenario


def channel(name: str, **arguments: Any) -> dict[str, FactorySpec]:
    """Return the change of a scenario that puts a channel between the players."""
    return {"channel": FactorySpec.of(f"channel:{name}", **arguments)}


def chain(*stages: dict[str, FactorySpec]) -> dict[str, FactorySpec]:
    """Return the change that puts several channels in sequence, in the order of the arguments."""
    return channel("chain", stages=[stage["channel"] for stage in stages])


def push(bound: float) -> dict[str, FactorySpec]:
    """Return the change that disturbs strategies by a random velocity, drawn anew every 25 steps."""
    return {"disturbance": FactorySpec.of("disturbance:uniform", bound=bound, dwell=25)}


FAULTS: dict[str, dict[str, dict[str, Any]]] = {
    "none": {"": {}},
    "messages lost": {f"{share:.0%}": channel("loss", probability=share) for share in (0.3, 0.6, 0.9)},
    "messages late": {f"{steps} steps": channel("delay", steps=steps) for steps in (1, 3, 9)},
    "messages noisy": {f"σ = {std:g}": channel("noise", std=std) for std in (1e-3, 1e-2, 1e-1)},
    "strategies pushed": {f"±{bound:g} per second": push(bound) for bound in (0.01, 0.1, 1.0)},
    "inputs saturate": {f"at {limit:g}": {"input_limit": limit} for limit in (10.0, 2.0, 1.0)},
    "all of it": {
        "a little": {
            **chain(channel("delay", steps=1), channel("loss", probability=0.3), channel("noise", std=1e-3)),
            **push(0.01),
            "input_limit": 10.0,
        }
    },
}


def main() -> None:
    """Measure the law under every fault."""
    base = get_scenario("random-energy")
    scenarios = [
        base.replace(name=f"{fault} {size}".strip(), **changes)
        for fault, sizes in FAULTS.items()
        for size, changes in sizes.items()
    ]
    results = ptne_env.evaluate(["static"], scenarios, episodes=30)
    for scenario in scenarios:
        digits = results.record(scenario.name, "static", "digits")
        print(f"{scenario.name:34} {digits['mean']:5.2f} digits [{digits['low']:.2f}, {digits['high']:.2f}]")


if __name__ == "__main__":
    main()
