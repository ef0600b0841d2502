"""Evaluate a law and a policy of your own from a script.

Run it with: python examples/evaluate_law.py
"""

import numpy as np

import ptne_env
from ptne_env import laws


class HalfSpeed:
    """A policy with the method predict() of Stable-Baselines3; it halves the actions of the static law."""

    interface = laws.Static.interface

    def __init__(self, layout: ptne_env.ObservationLayout) -> None:
        """Build the law for the observations of this layout."""
        self.law = laws.Static(layout, kappa=2.0)

    def predict(
        self,
        observation: np.ndarray,
        state: object = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = False,  # noqa: FBT001, FBT002 - Stable-Baselines3's signature
    ) -> tuple[np.ndarray, object]:
        """Return half of the law's actions."""
        actions, state = self.law.predict(observation, state, episode_start, deterministic)
        return actions / 2, state


def main() -> None:
    """Compare the static law at two gains with the policy above, on two scenarios, from the same 50 starts."""
    results = ptne_env.evaluate(
        {"static": "static", "static, κ = 4": "static(kappa=4)", "half speed": HalfSpeed},
        ["energy", "energy-switching-transformed"],
        episodes=50,
        seed=0,
    )
    for record in results.records:
        if record["metric"] == "digits":
            interval = f"[{record['low']:.2f}, {record['high']:.2f}]"
            print(f"{record['track']:30} {record['policy']:15} {record['mean']:.2f} digits {interval}")


if __name__ == "__main__":
    main()
