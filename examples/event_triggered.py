"""Send a message only when there is news: an event-triggered law, and the messages that it saves.

Players of Huo et al. (arXiv:2304.10338) broadcast their estimates at events instead of all the time. In this library a
message is the sender's estimate, so a player keeps its message by keeping its estimate: it adds up the moves that the
paper's static law asks for, and makes them all at once when their size exceeds the threshold δ e^{−ρs}, which falls as
the clock s runs. The strategy is held between the events too, and the gradient is that at the held estimate. The
threshold and its decay are ours, and no theorem covers them: the table says what they cost.

Prints the digits at the deadline, the messages to the deadline and the new ones among them.

Run it with: python examples/event_triggered.py
"""

import numpy as np

import ptne_env
from ptne_env import FactorySpec, laws
from ptne_env.evaluation import OPTIONAL, register
from ptne_env.perception.observation import Observation, ObservationLayout


class EventTriggered(laws.Static):
    """The static law, whose moves add up to the threshold δ e^{−ρs}; the memory holds those that are not made yet."""

    def __init__(self, layout: ObservationLayout, threshold: float, decay: float) -> None:
        """Build the law with δ and ρ."""
        super().__init__(layout)
        self.threshold, self.decay = threshold, decay

    def initial_memory(self, rows: int) -> np.ndarray:
        """Return no moves, shape (R, n)."""
        return np.zeros((rows, self.layout.dimension))

    def inputs(self, observation: Observation, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the inputs that make the moves of the players with an event, and the moves that remain."""
        wanted, _ = super().inputs(observation, None)
        pending = memory + observation.theta * wanted
        limit = self.threshold * np.exp(-self.decay * observation.transformed)
        has_event = np.linalg.norm(pending, axis=1, keepdims=True) > limit
        moves = np.where(has_event, pending, 0.0)
        return moves / observation.theta, pending - moves


def main() -> None:
    """Compare the static law with event-triggered ones from the same 20 starts."""
    for metric in OPTIONAL.values():
        register(metric)
    policies = [ptne_env.PolicySpec("every step", laws.Static)]
    for threshold, decay in ((0.1, 0.0), (1.0, 0.5), (1.0, 1.0), (10.0, 1.0)):
        law = FactorySpec.of("event_triggered:EventTriggered", threshold=threshold, decay=decay)
        policies.append(ptne_env.PolicySpec(f"δ = {threshold}, ρ = {decay}", law))
    results = ptne_env.evaluate(policies, "energy", episodes=20)
    for name in results.policies:
        digits, sent, new = (
            results.record("energy", name, metric)["mean"] for metric in ("digits", "messages", "new_messages")
        )
        print(f"{name:18} {digits:5.2f} digits, {new:4.0f} of {sent:.0f} messages are new ({new / sent:.0%})")


if __name__ == "__main__":
    main()
