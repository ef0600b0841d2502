"""What the examples of this folder share: the task, the digits that they must reproduce, and the report.

An episode that starts with ``reset(seed=k)`` is episode k of ``ptne_env.evaluate(..., seed=0, split="train")``. So a
law that acts through a framework's wrapper must gain the digits of ``evaluate``, episode by episode.
"""

import json
import statistics
from collections.abc import Callable, Sequence

import numpy as np

import ptne_env
from ptne_env import Interface, PolicySpec, laws
from ptne_env.envs.gymnasium import JointEnv
from ptne_env.perception.policy import NetworkPolicy, Policy
from ptne_env.world import distances

SCENARIO = "random-energy"
EPISODES = 4
LAW = {"interface": "physical"}
"""The argument of environments in which the law acts; trained policies act in the default, ``scaled``."""


def law(layout: ptne_env.ObservationLayout) -> Policy:
    """Return the paper's static law."""
    return laws.Static(layout, kappa=2.0)


def policy_of(act: Callable[[np.ndarray], np.ndarray]) -> Policy:
    """Return a policy for ``ptne_env.evaluate`` that acts by a function of whole blocks of observations (R, size)."""
    return NetworkPolicy(lambda rows, memory, *_: (act(rows), memory))


def digits(
    policy: Policy,
    interface: Interface = Interface(),  # noqa: B008 - it is frozen
    scenario: str = SCENARIO,
    episodes: int = 20,
) -> float:
    """Return the mean digits at the deadline over games outside of the training."""
    spec = PolicySpec("policy", policy, interface)
    results = ptne_env.evaluate([spec], scenario, episodes=episodes, split="validation")
    return float(results.samples[scenario, "policy"]["digits"].mean())


def joint_digits(act: Callable[[np.ndarray], np.ndarray]) -> float:
    """Return the mean digits of a policy that acts for all players, over 20 games outside of the training.

    Such a policy sees the observations of all players, so ``ptne_env.evaluate`` refuses it.

    Args:
        act: a function from joint observations (1, N · size) to joint actions (1, N · action size).
    """
    env, reached = JointEnv(SCENARIO), []
    for seed in range(1_000_000, 1_000_020):
        (observation, _), over = env.reset(seed=seed), False
        while not over:
            observation, _, terminated, truncated, _ = env.step(act(observation[None])[0])
            over = terminated or truncated
        state = env.parallel.get_state()
        reached.append(distances.digits(distances.estimate_distance(state.estimates, state.game)).item())
    return statistics.mean(reached)


def report(
    gained: Sequence[float],
    before: float | None = None,
    after: float | None = None,
    what: str = "",
) -> None:
    """Print one line of JSON, which ``run.py`` collects.

    Args:
        gained: the digits (mean over players of the return) that the law gained through the framework's wrapper in the
            episodes that ``reset(seed=0)``, ``reset(seed=1)``, … started.
        before: :func:`digits` of the untrained policy.
        after: :func:`digits` of the trained policy.
        what: the route or the trained policy, where an example has several.

    Raises:
        SystemExit: when the law gained other digits than in ``ptne_env.evaluate``, or the training gained none.
    """
    scenario = ptne_env.get_scenario(SCENARIO)
    results = ptne_env.evaluate("static", scenario, episodes=len(gained), split="train")
    expected = results.samples[SCENARIO, "static"]["digits_gained"][0]
    gained = np.asarray(gained, dtype=np.float64)
    difference = float(np.abs(gained - expected).max())
    if not difference < 1e-4:  # some frameworks have rewards in float32
        raise SystemExit(f"through the wrapper the law gained {gained} digits, in ptne_env.evaluate {expected}")
    if before is not None and after is not None and not after > before:
        raise SystemExit(f"training gained no digits: {before} before, {after} after")
    row = {"what": what, "law": float(gained.mean()), "difference": difference, "before": before, "after": after}
    print(json.dumps(row))
