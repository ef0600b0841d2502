"""Write a page for each family of scenarios: ``python -m baselines.pages`` writes ``docs/scenarios/`` and its pictures.

A family has one game or family of games. Its page shows an episode, the game's docstring, the spaces, the numbers that
theory asks for, and the digits of the best policies from ``results.csv``. It also draws an episode of every track of
ptne-v1, ``docs/images/tracks.png``.
"""

from __future__ import annotations

import inspect
from itertools import groupby

from matplotlib.figure import Figure

from baselines.published import ROOT, Published, markdown, read, with_interval
from ptne_env import CATALOGUE, record
from ptne_env.envs.rendering import MOST_ESTIMATES
from ptne_env.evaluation import POLICIES
from ptne_env.perception.encoder import Encoder
from ptne_env.shared.files import write_atomically
from ptne_env.shared.parts import resolve
from ptne_env.shared.style import drawing, encode
from ptne_env.suites import get_suite
from ptne_env.theory import monotonicity_constants
from ptne_env.world.catalogue import DESCRIPTIONS
from ptne_env.world.world import World

PAGES = ROOT / "docs" / "scenarios"
"""The folder of the pages."""

PICTURES, TRACKS = PAGES / "images", ROOT / "docs" / "images" / "tracks.png"
SUITE, BEST = "comparison", 5
"""The published comparison of scenarios, and the number of policies of it that a page shows."""

SHOWN, BEST_LAW = "static", "relay"
"""The policies in the pictures of families and of tracks."""

CONSTANTS = """
ε and ι are the constants of strong monotonicity and Lipschitz continuity in Assumption 4, with ≈ those of samples. λ2
is the algebraic connectivity of the graph, or the smallest one of its modes. Of a family of games the constants are
those of the first game.
"""
DIGITS = """
Mean digits of the best policies, and of the paper's law, with 95 % intervals, from
[the comparison of all scenarios](../../baselines/README.md).
"""


def families() -> dict[str, list[str]]:
    """The names of scenarios by family, which is the id of the game without ``game:``."""
    ordered = sorted(CATALOGUE, key=_family)
    return {family: list(names) for family, names in groupby(ordered, key=_family)}


def _family(name: str) -> str:
    return CATALOGUE[name].game.target.removeprefix("game:")


def page(family: str, names: list[str], numbers: Published) -> str:
    """The Markdown of a page."""
    part = CATALOGUE[names[0]].game
    kind = resolve(part.target)
    game, *_ = inspect.cleandoc(kind.__doc__).partition("\n\nRaises:")
    parts = [
        f"# {family}",
        f"![An episode of {names[0]} under the law {SHOWN}]({PICTURES.name}/{family}.png)",
        "`python -m baselines.pages` writes this page. [The environment](../environment.md) explains its words.",
        "## Game",
        f"`{part.target}` is `ptne_env.games.{kind.__name__}`.",
        f"```text\n{game}\n```",
        "## Scenarios",
        markdown(["scenario", ""], [[f"`{name}`", DESCRIPTIONS[name]] for name in names]).replace("---:", "---"),
        "## Spaces",
        _spaces(names[0]),
        "## Numbers",
        CONSTANTS.strip(),
        _numbers(names),
        "## Results",
        DIGITS.strip(),
        _results(names, numbers),
    ]
    return "\n\n".join(parts) + "\n"


def _spaces(name: str) -> str:
    """The sizes of observations and actions under each interface."""
    world = World(CATALOGUE[name])
    layouts = {kind: Encoder(world, kind).layout for kind in ("scaled", "physical")}
    rows = [
        [f"`{kind}`", f"({layout.size},) float32", f"({layout.action_size},) float32"]
        for kind, layout in layouts.items()
    ]
    return markdown(["interface", "observation", "action"], rows)


def _numbers(names: list[str]) -> str:
    rows = []
    for name in names:
        scenario, world = CATALOGUE[name], World(CATALOGUE[name])
        constants = monotonicity_constants(world.game)
        sign = "" if constants.exact else "≈ "
        connectivity = min(graph.algebraic_connectivity for graph in world.topology.graphs)
        cells = (scenario.deadline, scenario.gain, scenario.steps, scenario.s_end, connectivity)
        game = f"{sign}{constants.epsilon:.3g}", f"{sign}{constants.iota:.3g}"
        rows.append(
            [f"`{name}`", f"{world.game.num_players}, {world.game.dimension}", *game, *(f"{c:.3g}" for c in cells)]
        )
    return markdown(["scenario", "N, n", "ε", "ι", "T in s", "c in 1/s", "steps", "s_end", "λ2"], rows)


def _results(names: list[str], numbers: Published) -> str:
    """A row per policy and a column per scenario."""
    best = {"static", *(policy for name in names for policy in numbers.ranked(SUITE, name)[:BEST])}
    policies = [policy for policy in POLICIES if policy in best and POLICIES[policy].is_ranked]
    rows = [[policy, *(with_interval(numbers.cell(SUITE, name, policy)) for name in names)] for policy in policies]
    return markdown(["policy", *(f"`{name}`" for name in names)], rows)


def write(numbers: Published) -> None:
    """Write the texts of the pages."""
    for family, names in families().items():
        write_atomically(PAGES / f"{family}.md", page(family, names, numbers))


def draw_tracks() -> bytes:
    """The picture of an episode of every track."""
    tracks, columns = get_suite("ptne-v1").tracks, 3
    rows = -(-len(tracks) // columns)
    with drawing("figures"):
        figure = Figure(figsize=(4 * columns, 3 * rows), layout="constrained")
        for part, track in zip(figure.subfigures(rows, columns).flat, tracks, strict=False):
            run = record(BEST_LAW, f"ptne-v1/{track.name}")
            run.plot(
                part.subplots(2, sharex=True, height_ratios=[3, 2]), estimates=run.estimates[0].size <= MOST_ESTIMATES
            )
            part.suptitle(track.name)
        return encode(figure, "png", dpi=80)


def main() -> None:
    """Write the pages and draw all pictures."""
    write(read())
    write_atomically(TRACKS, draw_tracks())
    for family, (first, *_) in families().items():
        record(SHOWN, first).save(PICTURES / f"{family}.png")


if __name__ == "__main__":
    main()
