"""Mixed teams: some players follow one law, the others another.

Prints the digits at the deadline in random energy games for every number of players, from none to all, that follow the
tuned static law while the others keep the paper's gains; 50 episodes each.

Run it with: python examples/mixed_team.py
"""

from ptne_env import FactorySpec, get_scenario
from ptne_env.evaluation import Teammates, Track
from ptne_env.suites import Suite, run_suite

PAPER = FactorySpec.of("law:static", kappa=2.0)
POLICY = "static-tuned"


def teams() -> Suite:
    """A track per team: the last players of the five are teammates that follow the paper's law."""
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
    """Run the policy in every team; the reference policy "static" is the paper's law in all of them."""
    results = run_suite(teams(), [POLICY])
    digits = {"0 of 5": results.summary("5 of 5", "static", "digits")}
    digits |= {track.name: results.summary(track.name, POLICY, "digits") for track in results.tracks}
    for name, found in digits.items():
        print(f"{name} follow {POLICY}: {found.mean:.2f} digits [{found.low:.2f}, {found.high:.2f}]")


if __name__ == "__main__":
    main()
