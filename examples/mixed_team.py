"""Evaluate mixed teams, in which some players follow one law and the others another.

From none to all of five players follow the tuned static law in random energy games, while the others keep the paper's
gains. Prints the digits at the deadline of each team, over 50 episodes.

Run it with: python examples/mixed_team.py
"""

from ptne_env import FactorySpec, get_scenario
from ptne_env.evaluation import Teammates, Track
from ptne_env.suites import Suite, run_suite

PAPER = FactorySpec.of("law:static", kappa=2.0)
POLICY = "static-tuned"


def teams() -> Suite:
    """Return a suite with a track per team, in which the last players are teammates that follow the paper's law."""
    base = get_scenario("random-energy")
    tracks = tuple(
        Track(
            f"{number} of 5",
            base,
            "The others follow the paper's law.",
            teammates=Teammates(PAPER, tuple(range(number, 5))) if number < 5 else None,
        )
        for number in range(1, 6)
    )
    return Suite("teams-v1", tracks, episodes=50)


def main() -> None:
    """Run the policy in every team. The reference policy "static" follows the paper's law, as its teammates do."""
    results = run_suite(teams(), [POLICY])
    digits = {"0 of 5": results.summary("5 of 5", "static", "digits")}
    digits |= {track.name: results.summary(track.name, POLICY, "digits") for track in results.tracks}
    for name, summary in digits.items():
        print(f"{name} follow {POLICY}: {summary.mean:.2f} digits [{summary.low:.2f}, {summary.high:.2f}]")


if __name__ == "__main__":
    main()
