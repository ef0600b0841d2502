# ruff: noqa: INP001 - conf.py imports it from its folder
"""A page of the site for every scenario of the catalogue: its costs, a picture, and its numbers, all computed here.

The pages are written to docs/scenarios/, which is not under version control, before Sphinx reads the documents.
"""

import inspect
import io
import re
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import formulas
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console

import ptne_env
from ptne_env import theory
from ptne_env.bench import report
from ptne_env.evaluation import POLICIES
from ptne_env.evaluation.suite import comparison
from ptne_env.evaluation.traces import Scene, scene
from ptne_env.shared.files import write_atomically
from ptne_env.shared.parts import FactorySpec, resolve
from ptne_env.shared.style import COLOURS, INK, drawing, panels
from ptne_env.theory.paper.figures import draw_network
from ptne_env.world.catalogue import CATALOGUE, DESCRIPTIONS
from ptne_env.world.world import World

FOLDER = Path(__file__).parent / "scenarios"
LAWS = "static", "adaptive", "grounded", "contact-relay"
EPISODES = 10


def write_pages() -> None:
    """Write the pages that are missing or older than the code, and their table of contents."""
    sources = [*Path(ptne_env.__file__).parent.rglob("*.py"), Path(__file__), Path(formulas.__file__)]
    newest = max(path.stat().st_mtime for path in sources)
    old = [name for name in CATALOGUE if not _is_newer(FOLDER / f"{name}.md", newest)]
    FOLDER.mkdir(exist_ok=True)
    if old:
        with ProcessPoolExecutor() as workers:
            for name, text in zip(old, workers.map(page, old), strict=True):
                write_atomically(FOLDER / f"{name}.md", text)
    if old or not (FOLDER / "index.md").exists():
        write_atomically(FOLDER / "index.md", _contents())
    for path in FOLDER.glob("*.md"):
        if path.stem not in {"index", *CATALOGUE}:
            path.unlink()


def _is_newer(path: Path, time: float) -> bool:
    return path.exists() and path.stat().st_mtime > time


def _contents() -> str:
    rows = "".join(f"| [{name}]({name}.md) | {sentence} |\n" for name, sentence in DESCRIPTIONS.items())
    tree = "\n".join(CATALOGUE)
    return (
        "# The scenarios\n\nOne page for each scenario of the catalogue, with its costs, a picture and its numbers, "
        "computed when this site was built. [The environment](../environment.md) explains their parts.\n\n"
        f"| Scenario | Description |\n| --- | --- |\n{rows}\n```{{toctree}}\n:hidden:\n\n{tree}\n```\n"
    )


def _graph(world: World) -> str:
    topology = world.topology
    links = f"{len(topology.union.edges)} links"
    if topology.is_fixed:
        return f"{links}, fixed"
    time = "s of t" if topology.clock == "physical" else "of s"
    return f"{links}, of which {len(topology.graphs)} modes are up for {topology.dwells[0]:g} {time} each, in turn"


def page(name: str) -> str:
    """The Markdown text of a scenario's page."""
    scenario = CATALOGUE[name]
    world = World(scenario)
    suite = comparison([name], episodes=EPISODES)  # the episodes of the table
    start = suite.episode_set(name, seed=0).initial_state(suite.track(name).world)
    shown = scene(suite.track(name).world, start, {law: POLICIES[law] for law in LAWS})
    pictures = "\n".join(re.sub(r"\n\s*\n", "\n", panel) for panel in _panels(world, shown))
    certify = f"ptne certify {name}"
    compare = f"ptne compare --scenario {name} --policy {','.join(LAWS)} --episodes {EPISODES}"
    episodes = f"the median of {shown.episodes} episodes, with the band from 10 % to 90 %"
    modes = "" if world.topology.is_fixed else ", whose dotted links are down in the first mode"
    return f"""# {name}

{DESCRIPTIONS[name]}

{_game(scenario.game, world)}{_numbering(world)}

```{{raw}} html
<figure><div class="panels" role="img" aria-label="Estimates, errors and graph of {name}">
{pictures}
</div><figcaption>First: one episode under the static law; strategies thick, estimates of them thin, the equilibrium
dotted. Second: the error of all estimates under four laws, {episodes}. The vertical lines are the deadline T. Third:
the graph{modes}; players have the numbers and colours of their agents, 0 is <code>player_0</code>.</figcaption>
</figure>
```

## Settings

| Setting | Value |
| --- | --- |
{_settings(world)}

## Digits at the deadline

{_digits(name)}

Mean digits at T with 95 % intervals, from {EPISODES} random starts. Printed, with all other metrics, by
`{compare}`.

## Predictions

Printed by `{certify}`; [the theory](../theory.md) explains the rows.

```text
{_certificate(name)}
```
"""


def _game(factory: FactorySpec, world: World) -> str:
    """The costs as a displayed formula, and the first part of the docstring."""
    member, named = type(world.game), resolve(factory.target)
    costs, _ = formulas.leading_formulas(_description(member))
    _, rest = formulas.leading_formulas(_description(named))
    display = f"```{{math}}\n{costs}\n```\n\n" if costs else ""
    rest = re.sub(r":(\w+):`", r"{py:\1}`", rest.lstrip(" ,.:").strip())
    return f"{display}{rest[:1].upper()}{rest[1:]}\n\nThe class is {{py:class}}`{named.__module__}.{named.__name__}`."


def _numbering(world: World) -> str:
    """A sentence for formulas that name single players."""
    numbered = re.search(r"\b[xJ]_?1\b", _description(type(world.game)))
    return " Formulas count players from 1, as the paper does: player 1 is the agent `player_0`." if numbered else ""


def _description(part: Any) -> str:
    """A docstring without its sections."""
    return re.split(r"^(?:Args|Raises|Attributes):$", inspect.getdoc(part) or "", flags=re.MULTILINE)[0].strip()


def _settings(world: World) -> str:
    scenario, game = world.scenario, world.game
    constants = theory.problem_constants(world)
    kind = "exact" if constants.exact else "from samples"
    games = "of a typical game of the family, " if world.has_random_game else ""
    equilibrium = "drawn in every episode" if world.has_random_game else f"({_numbers(game.nash_equilibrium)})"
    rows = {
        "players N, dimension n of all strategies": f"{game.num_players}, {game.dimension}",
        "graph": _graph(world),
        "deadline T, constant gain c": f"{scenario.deadline:g} s, {scenario.gain:g} /s",
        "steps K, end of transformed time s_end": f"{scenario.steps}, {scenario.s_end:g}",
        "effective time τ_K": f"{world.clock.effective_time:.3g}",
        "Nash equilibrium x*": equilibrium,
        "monotonicity ε, Lipschitz constant ι": f"{constants.epsilon:.3g}, {constants.iota:.3g} ({games}{kind})",
        "algebraic connectivity λ2 of the union of all graphs": f"{world.topology.union.algebraic_connectivity:.3g}",
        "strategies confined to a box": "yes" if game.has_bounds else "no",
    }
    return "\n".join(f"| {name} | {_minus(value)} |" for name, value in rows.items())


def _numbers(values: np.ndarray) -> str:
    return ", ".join(f"{value:.4g}" for value in values)


def _minus(text: str) -> str:
    """The text with the sign of minus before numbers."""
    return re.sub(r"(?<![\w-])-(?=\d)", "−", text)


def _digits(name: str) -> str:
    results = ptne_env.evaluate(LAWS, [name], episodes=EPISODES)
    records = [record for record in results.records if record["metric"] == "digits"]
    tracks = list(dict.fromkeys(record["track"] for record in records))
    cells = {(record["policy"], record["track"]): _interval(record) for record in records}
    head = f"| Policy | {' | '.join(tracks)} |\n| --- |{' ---: |' * len(tracks)}\n"
    return head + "".join(f"| `{law}` | {' | '.join(cells[law, track] for track in tracks)} |\n" for law in LAWS)


def _interval(record: dict[str, Any]) -> str:
    mean, low, high = (_minus(f"{record[part]:.3g}") for part in ("mean", "low", "high"))
    return mean if low == high else f"{mean} [{low}, {high}]"


def _certificate(name: str) -> str:
    console = Console(file=io.StringIO(), width=88)
    console.print(report.certificate_tables(theory.certify(CATALOGUE[name].replace(hold_steps=50))))
    return "\n".join(line.rstrip() for line in console.file.getvalue().strip("\n").splitlines())


def _panels(world: World, shown: Scene) -> list[str]:
    with drawing("pictures", {"font.size": 10}):
        figure = Figure(figsize=(10.5, 3.1), layout="constrained")
        draw_episode(world, shown, *figure.subplots(1, 3, width_ratios=(3, 3, 2)))
        return panels(figure)


def draw_episode(world: World, shown: Scene, strategies: Axes, errors: Axes, graph: Axes) -> None:
    """The estimates under the first law of a scene, the errors under all of its laws, and the graph."""
    draw_network(graph, world.topology.graphs[0], world.topology.union)
    graph.set_title("graph")
    first, *_ = shown.traces
    estimates = shown.traces[first].estimates
    for component, owner in enumerate(shown.owners):
        colour = COLOURS[owner % len(COLOURS)]
        others = [player for player in range(shown.num_players) if player != owner]
        strategies.plot(shown.t, estimates[component, others].T, color=colour, linewidth=0.6, alpha=0.55)
        strategies.plot(shown.t, estimates[component, owner], color=colour, linewidth=1.7)
        strategies.plot(shown.t, shown.equilibrium[component], color=colour, linestyle=(0, (1, 2)), linewidth=0.9)
    strategies.set(xlabel="time $t$ [s]", ylabel="estimates $x^i_j$")
    strategies.set_title(f"{first} law, one episode")
    for colour, (law, trace) in zip(COLOURS, shown.traces.items(), strict=False):
        low, median, high = np.maximum(trace.errors, 1e-13)
        errors.fill_between(shown.t, low, high, color=colour, alpha=0.15, linewidth=0)
        errors.semilogy(shown.t, median, color=colour, label=law)
    for axes in (strategies, errors):
        deadline = world.scenario.deadline
        axes.axvline(deadline, color=INK, linewidth=0.8)
        axes.annotate("$T$", (deadline, 1), (0, 2), ("data", "axes fraction"), "offset points", ha="center")
    errors.set(xlabel="time $t$ [s]", ylabel="relative error")
    errors.set_title(f"{len(shown.traces)} laws, {shown.episodes} episodes")
    if len(shown.traces) > 1:
        errors.legend(loc="upper center", bbox_to_anchor=(0.45, -0.2), ncols=4, columnspacing=0.9, handlelength=1.1)


if __name__ == "__main__":
    write_pages()
