"""A policy of your own on the leaderboard of the benchmark.

Prints, for five tracks of the benchmark and 20 episodes each, the digits and the rank of the policy below, of the
reference policies of every suite, and of two laws; and the scores over all five tracks, in which 1 is the paper's law.

Run it with: python examples/custom_policy.py
or, for the whole benchmark, from its folder: ptne compare --suite ptne-v1 --policy custom_policy:make --trust
"""

import numpy as np

from ptne_env import ObservationLayout
from ptne_env.evaluation import run_suite

TRACKS = ("nominal", "switching-transformed", "noise", "coarse-step", "short-deadline")


class EvenPace:
    """The paper's static law with gains per step instead of gains per time.

    In every step it moves by ``gradient`` times the own gradient and ``consensus`` times the mean difference to the
    neighbours, for any length of the step; so it is neither slow in short steps nor overshoots in long ones.
    """

    def __init__(self, layout: ObservationLayout, gradient: float = 0.25, consensus: float = 0.5) -> None:
        """The layout describes the observations; a policy has no other information."""
        self.layout, self.gradient, self.consensus = layout, gradient, consensus

    def predict(
        self,
        observation: np.ndarray,
        state: object = None,
        episode_start: np.ndarray | None = None,  # noqa: ARG002 - this policy has no memory
        deterministic: bool = False,  # noqa: ARG002, FBT001, FBT002 - Stable-Baselines3's signature
    ) -> tuple[np.ndarray, object]:
        """Actions for one observation per row."""
        parsed = self.layout.read(observation)
        degree = np.maximum(parsed.weights.sum(axis=1, keepdims=True), 1.0)
        pull = np.einsum("rd,rdn->rn", parsed.weights, parsed.relative_estimates) / degree
        move = self.consensus * pull - self.gradient * parsed.gradient
        return self.layout.write(move / np.maximum(parsed.theta, 1e-9), parsed), state


def make(layout: ObservationLayout) -> EvenPace:
    """The function that ``--policy custom_policy:make`` calls."""
    return EvenPace(layout)


def main() -> None:
    """Run a small part of the benchmark and print the row of the policy beside the others."""
    results = run_suite("ptne-v1", ["custom_policy:make", "grounded", "static-tuned"], tracks=TRACKS, episodes=20)
    board = results.leaderboard
    print(f"{'digits (rank)':20}" + "".join(f"{track:>23}" for track in TRACKS) + f"{'score':>7}")
    for row in board.overall:
        digits = (results.summary(track, row.policy, "digits").mean for track in TRACKS)
        ranks = (board.row(track, row.policy).rank or "oracle" for track in TRACKS)
        texts = (f"{number:.2f} ({rank})" for number, rank in zip(digits, ranks, strict=True))
        print(f"{row.policy:20}" + "".join(f"{text:>23}" for text in texts) + f"{row.score.mean:7.2f}")


if __name__ == "__main__":
    main()
