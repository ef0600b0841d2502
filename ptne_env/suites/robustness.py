"""The suite robustness: random worlds unlike those of the catalogue, on which a good policy is never bad.

Every number of a world is drawn as in a Latin hypercube: each of 100 equal parts of its range holds one world. So every
seed has the same shares of large games, switching graphs, lossy channels and so on, in other combinations.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.sparse.csgraph import shortest_path

from ptne_env.evaluation.tracks import Suite, Track
from ptne_env.shared.arrays import FloatArray, ordered_sum
from ptne_env.shared.parts import FactorySpec
from ptne_env.world.graphs import Graph
from ptne_env.world.scenario import Scenario

WORLDS = 100

EPISODES = 6
"""Number of episodes of a world; large games, which take most of the time, have fewer."""

# fmt: off
KINDS = {
    "start": {"around 0": 88, "at 0": 5, "at x*": 7},
    "graph": {"random": 20, "ring": 12, "path": 10, "tree": 8, "star": 10, "episode": 12, "physical": 10,
              "transformed": 10, "links": 8},
    "game": {"energy": 20, "affine": 20, "box": 8, "saturating": 14, "rotation": 14, "complements": 12,
             "rank-deficient": 12},
}
"""The kinds of starts, graphs and games, with their numbers of worlds."""

MOST_PLAYERS = {"complements": 30, "rank-deficient": 30, "saturating": 20, "star": 30, "episode": 20}
"""Of kinds whose worlds are slow, or long to write down, with 100 players."""

NUMBERS = {
    "deadline": (1, 0.1, 10), "steps": (1, 50, 1200), "pace": (1, 0.5, 1.6), "end": (1, 5, 7),  # the clock
    "players": (1, 2.6, 10), "crowd": (0.15, 10, 101), "components": (0.3, 2, 4),  # a crowd has more players
    "size": (1, 0.3, 30), "extreme": (0.3, 1e-6, 1e3), "null": (0.06, 1, 1),  # of x*; null: x* = 0
    "stiffness": (1, 0.3, 3), "ratio": (1, 2, 200), "asymmetry": (1, 0.03, 1), "bend": (1, 1, 20),
    "pull": (1, 0.03, 0.3), "turn": (1, 1, 30),  # ε and the asymmetry of games that rotate
    "gap": (1, 0.01, 0.3), "rank": (1, 1, 3),  # of complements from instability; of couplings
    "reach": (1, 0.01, 100), "far": (0.25, 1e-12, 1e6), "push": (0.3, 3, 100),  # of starts and inputs
    "links": (1, 0.05, 1), "modes": (1, 2, 5), "rounds": (1, 3, 50), "uneven": (0.5, 2, 10),  # the graph
    "faulty": (0.75, 1, 1), "range": (0.5, 3, 5),  # the channel, with errors relative to the size
    "bias": (0.2, 0.001, 0.03), "noise": (0.35, 0.0001, 0.3), "tails": (0.15, 0.0003, 0.01),
    "late": (0.15, 0.0003, 0.03), "onset": (1, 0.2, 0.8), "rounding": (0.25, 0.001, 0.1),
    "liars": (0.12, 1, 3), "lie": (1, 0.3, 10),
    "loss": (0.3, 0.05, 0.8), "burst": (0.3, 3, 30), "delay": (0.3, 2, 21),
}
"""The share of worlds in which a number is not 0, its smallest and its largest value there, on a logarithmic scale."""
# fmt: on

ERRORS = ("bias", "noise", "tails", "late", "rounding", "liars")
"""The numbers that make messages wrong; loss and delay only make them late."""

Numbers: TypeAlias = "dict[str, float]"

part = FactorySpec.of


class DrawnGame(NamedTuple):
    """A game or family, its largest curvature, its number of components, its description, and x* where it is known."""

    spec: FactorySpec
    largest: float
    dimension: int
    description: str
    equilibrium: FloatArray | None = None


@cache
def robustness(seed: int = 1) -> Suite:
    """Return the suite of the 100 random worlds of a seed; laws may be tuned on those of seed 1 alone."""
    generator = np.random.default_rng(seed)
    places = {name: generator.permutation(WORLDS) + generator.random(WORLDS) for name in (*KINDS, *NUMBERS)}
    tracks = []
    for world in range(WORLDS):
        kinds = {
            name: str(np.repeat([*worlds], [*worlds.values()])[int(places[name][world])])
            for name, worlds in KINDS.items()
        }
        numbers = {name: _number(places[name][world], *limits) for name, limits in NUMBERS.items()}
        tracks.append(_track(f"world-{world + 1:03}", kinds, numbers, np.random.default_rng((seed, world))))
    return Suite("robustness" if seed == 1 else f"robustness-{seed}", tuple(tracks), EPISODES)


def _number(place: float, share: float, low: float, high: float) -> float:
    """Return the number at a place in (0, 100): 0 in the worlds that have none."""
    unit = place / WORLDS / share
    return _rounded(low * (high / low) ** unit) if unit < 1 else 0.0


def _rounded(number: float) -> float:
    """Return a number with three digits."""
    return float(f"{number:.3g}")


def _track(name: str, kinds: dict[str, str], numbers: Numbers, generator: np.random.Generator) -> Track:
    """Return the world of some kinds and numbers; the generator draws links and single games."""
    if kinds["start"] == "at x*" and kinds["game"] != "complements":  # others draw x* anew in every episode
        kinds["game"] = "rank-deficient"
    most = [MOST_PLAYERS.get(kind, 100) for kind in kinds.values()]
    players = min(int(numbers["crowd"] or numbers["players"]), *most)
    graph = kinds["graph"] if players > 2 else "path"
    # A tree has no way round a liar. Where all start at x*, errors would reward those that stand still.
    absent = [*ERRORS * (kinds["start"] == "at x*"), *["liars"] * (graph in ("path", "tree", "star"))]
    numbers |= dict.fromkeys(absent if numbers["faulty"] else [*ERRORS, "loss", "delay"], 0.0)
    factor = numbers["far"] or numbers["reach"]
    numbers["size"] = size = _rounded(min(numbers["extreme"] or numbers["size"], 1000 / factor))
    numbers["scale"] = scale = size if kinds["game"] == "energy" or not numbers["null"] else 0.0
    game = GAMES[kinds["game"]](players, numbers, generator)
    links = _links(graph, players, numbers, generator)
    pool = links.build()
    densest = pool if isinstance(pool, Graph) else max(pool.graphs, key=lambda graph: graph.largest_degree)
    # The paper's law with κ = 2 is stable up to Θ = 2/(ι + 2 λ_max(L)), about; the steps are 0.25 to 0.8 of that.
    pace = numbers["pace"] if players <= 12 else 1.6  # small steps of large games take too long
    step = pace / (game.largest + 2 * float(np.linalg.eigvalsh(densest.laplacian)[-1]))
    diameter = float(shortest_path(densest.adjacency, unweighted=True).max())
    wanted = max(min(numbers["steps"], 6_000 / players), 1.5 * diameter, 4 * numbers["delay"])
    numbers["steps"] = steps = round(max(wanted, 1.2 * numbers["end"] / step))
    numbers["gain"] = _rounded(max(steps * step - numbers["end"], 0.2 * numbers["end"]) / numbers["deadline"])
    topology, change = _topology(graph, links, densest, numbers, generator)
    # Estimates and gradients beyond 5e5 would count as diverged.
    reach = _rounded(min(size * factor, 5e4 / game.largest / math.sqrt(players)))
    start, starts = part("start:uniform", low=-reach, high=reach), f"within ±{reach:g}"
    if kinds["start"] != "around 0":
        reach, starts = 0.0, kinds["start"]
        at = np.zeros(game.dimension) if game.equilibrium is None or starts == "at 0" else game.equilibrium
        start = part("start:fixed", estimates=np.tile(at, (players, 1)))
    natural = game.largest * max(size, reach)
    push = numbers["push"] * natural or max(1000.0, 10 * natural)
    # Where games rotate, the paper's law may be unstable, and should not diverge.
    push = _rounded(min(1000.0, natural) if kinds["game"] == "rotation" else push)
    stages, troubles = _channel(numbers)
    limit = _rounded(numbers["range"] * max(size, reach)) or None
    scenario = Scenario(
        name=name,
        game=game.spec,
        topology=topology,
        start=start,
        deadline=numbers["deadline"],
        gain=numbers["gain"],
        steps=steps,
        s_end=numbers["end"],
        input_limit=push,
        channel=part("channel:chain", stages=stages),
        message_range=limit,
    )
    troubles += [] if limit is None else [f"range {limit:g}"]
    sentence = (
        f"{players} players, {game.description}, {f'equilibria ±{scale:g}' if scale else 'x* = 0'}; {change}; "
        f"T = {numbers['deadline']:g}, {steps} steps; starts {starts}; inputs up to {push:g}; "
        f"{', '.join(troubles) or 'a perfect channel'}."
    )
    return Track(name, scenario, sentence, episodes=EPISODES if players <= 12 else 4 if players <= 40 else 3)


def _energy(players: int, numbers: Numbers, _generator: np.random.Generator) -> DrawnGame:
    """Return a family of energy games."""
    low = _rounded(numbers["stiffness"] / math.sqrt(numbers["ratio"]))
    high, coupling = _rounded(low * numbers["ratio"]), _rounded(low * players**-0.5)
    arguments = {"curvature": (low, high), "target": (-numbers["scale"], numbers["scale"]), "coupling": (0.0, coupling)}
    spec = part("game:random-energy", players=players, base_price=0.0, **arguments)
    return DrawnGame(spec, 2 * high + coupling * (1 + players), players, f"energy, ratio {numbers['ratio']:g}")


def _affine(players: int, numbers: Numbers, _generator: np.random.Generator, kind: str = "affine") -> DrawnGame:
    """Return a family of affine games, or one of a kind that is made of them."""
    stiffness, ratio, bend = numbers["stiffness"], numbers["ratio"], numbers["bend"] * (kind == "saturating")
    ratio = min(ratio, 10.0) if bend else ratio
    pull, turn = stiffness / math.sqrt(ratio), stiffness * numbers["asymmetry"]
    spread, told = pull * (ratio - 1), f"affine{' in a box' * (kind == 'box')}, ratio {ratio:g}"
    if kind == "rotation":
        pull, turn, spread = numbers["pull"], numbers["turn"], stiffness
        told = f"rotating, ε = {pull:g}, asymmetry {turn:g}"
    bounds = {"low": -0.7 * numbers["size"], "high": 0.9 * numbers["size"]} if kind == "box" else {}
    curvatures = {"epsilon": pull, "spread": spread, "asymmetry": turn}
    arguments = {name: _rounded(number) for name, number in (curvatures | bounds).items()}
    components = max(int(numbers["components"]), 1) if players <= 8 else 1
    spec = part("game:random-affine", players=players, scale=numbers["scale"], action_dim=components, **arguments)
    if bend:
        spec, told = part("game:random-saturating", affine=spec, bend=bend), f"saturating, bend {bend:g}"
    told += f", {components} components each" * (components > 1)
    return DrawnGame(spec, pull + spread + turn + 3 * bend, players * components, told)


def _complements(players: int, numbers: Numbers, generator: np.random.Generator) -> DrawnGame:
    """Return a game of strategic complements: A = √d (I − (1 − gap) W) √d with ‖W‖ = 1, W ≥ 0, and curvatures d."""
    weights = np.tril(generator.random((players, players)), -1)
    weights += weights.T
    total = np.sqrt(ordered_sum(weights))
    roots = np.sqrt(numbers["stiffness"] * min(numbers["ratio"], 10.0) ** generator.uniform(-0.5, 0.5, players))
    matrix = (np.eye(players) - (1 - numbers["gap"]) * weights / total / total[:, None]) * roots * roots[:, None]
    return _single(matrix, numbers, generator, f"complements, {numbers['gap']:g} from instability")


def _rank_deficient(players: int, numbers: Numbers, generator: np.random.Generator) -> DrawnGame:
    """Return a game whose players feel one or two weighted sums of some strategies, beside their own curvature."""
    rank = min(int(numbers["rank"]), players - 1)
    loads = generator.normal(size=(players, rank)) * (generator.random((players, rank)) < 0.7)
    curvatures = numbers["stiffness"] * numbers["ratio"] ** generator.uniform(-0.5, 0.5, players)
    matrix = np.diag(curvatures) + ordered_sum(loads[:, None] * loads, axis=2) * numbers["stiffness"] / players
    return _single(matrix, numbers, generator, f"coupling of rank {rank}, ratio {numbers['ratio']:g}")


def _single(matrix: FloatArray, numbers: Numbers, generator: np.random.Generator, told: str) -> DrawnGame:
    """Return an affine game that all episodes play."""
    matrix = matrix.round(6)
    equilibrium = np.array([_rounded(numbers["scale"] * unit) for unit in generator.uniform(-1, 1, len(matrix))])
    spec = part("game:quadratic", matrix=matrix, offset=-ordered_sum(matrix * equilibrium, axis=1))
    return DrawnGame(spec, float(np.linalg.norm(matrix, 2)), len(matrix), told, equilibrium)


GAMES: dict[str, Callable[[int, Numbers, np.random.Generator], DrawnGame]] = {
    "energy": _energy,
    "affine": _affine,
    "box": partial(_affine, kind="box"),
    "rotation": partial(_affine, kind="rotation"),
    "saturating": partial(_affine, kind="saturating"),
    "complements": _complements,
    "rank-deficient": _rank_deficient,
}


def _links(kind: str, players: int, numbers: Numbers, generator: np.random.Generator) -> FactorySpec:
    """Return a graph: of all links where they switch, and a pool of graphs where episodes draw one."""
    if kind in ("ring", "path", "star"):
        return part(f"topology:{kind.replace('ring', 'cycle')}", players=players)
    if kind == "episode":
        probability = round(min(1.0, 1.5 * math.log(players + 1) / players), 2)
        seed = int(generator.integers(1_000_000))
        return part("topology:random-graphs", players=players, probability=probability, modes=20, seed=seed)
    order = generator.permutation(players).tolist()
    links = {tuple(sorted((order[i], order[int(generator.integers(i))]))) for i in range(1, players)}
    for _ in range(round(numbers["links"] * players) * (kind != "tree")):
        links.add(tuple(sorted(generator.choice(players, 2, replace=False).tolist())))
    return part("topology:edges", players=players, edges=sorted((int(i), int(j)) for i, j in links))


def _topology(
    kind: str, links: FactorySpec, graph: Graph, numbers: Numbers, generator: np.random.Generator
) -> tuple[FactorySpec, str]:
    """Return the topology of a kind, and its description; a switching one shares its links out to a few modes."""
    if kind not in ("physical", "transformed", "links"):
        return links, {"random": "a fixed graph", "episode": "a random graph per episode"}.get(kind, f"a {kind}")
    modes, uneven = int(numbers["modes"]), numbers["uneven"] or 1.0
    deadline, gain, whole = numbers["deadline"], numbers["gain"], numbers["end"]
    step = (whole + gain * deadline) / numbers["steps"]  # the longest, and the last, on the transformed clock
    if kind == "physical":  # where the first step or the last, which goes on to the deadline, is the longest
        step = max(step / (gain + 1 / deadline), 0.5 * deadline * math.exp(step - whole))
        whole = deadline
    shortest = _rounded(max(2.02 * step, whole / modes / numbers["rounds"] / math.sqrt(uneven)))
    if kind == "links":
        dwells = [shortest, _rounded(shortest * uneven)]
        topology = part("topology:random-edges", graph=links, probability=0.5, dwells=dwells, clock="transformed")
        change = "links up and down at random"
    else:
        shares = [graph.edges[mode::modes] for mode in range(modes)]
        graphs = [part("topology:edges", players=graph.num_players, edges=edges) for edges in shares]
        dwells = [_rounded(shortest * uneven**unit) for unit in generator.random(modes)]
        topology = part("topology:periodic", graphs=graphs, dwells=dwells, clock=kind)
        change = f"{modes} graphs in turn on the {kind} clock"
    return topology, f"{change}, dwells {min(dwells):g} to {max(dwells):g}"


def _channel(numbers: Numbers) -> tuple[list[FactorySpec], list[str]]:
    """Return the stages of a channel, with errors relative to the size of the game, and their descriptions."""
    bias, noise, tails, late, rounding, lie = (
        _rounded(numbers["size"] * numbers[name]) for name in ("bias", "noise", "tails", "late", "rounding", "lie")
    )
    onset, longest, liars = round(numbers["steps"] * numbers["onset"]), int(numbers["delay"]), int(numbers["liars"])
    loss, burst = numbers["loss"], numbers["burst"]
    lost: tuple[str, str, dict[str, float]] = (f"loss {loss:.2g}", "channel:loss", {"probability": loss})
    if burst and loss:  # a burst ends and begins with such probabilities that the same share of messages is lost
        end = _rounded(min(1 / burst, (1 - loss) / loss))
        begin = _rounded(min(1.0, end * loss / (1 - loss)))
        lost = (f"loss {loss:.2g} in bursts", "channel:bursts", {"to_bad": begin, "to_good": end})
    stages: list[tuple[float, str, str, dict[str, float]]] = [
        *[(lie, f"liar {lie:.2g}", "channel:liar", {"size": lie})] * liars,
        (bias, f"bias {bias:.2g}", "channel:bias", {"bound": bias}),
        (noise, f"noise {noise:.2g}", "channel:noise", {"std": noise}),
        (tails, f"heavy tails {tails:.2g}", "channel:heavy-tails", {"scale": tails}),
        (late, f"noise {late:.2g} from step {onset}", "channel:late-noise", {"std": late, "step": onset}),
        (rounding, f"rounding {rounding:.2g}", "channel:rounding", {"width": rounding}),
        (loss, *lost),
        (longest, f"delay 0 to {longest}", "channel:delay", {"steps": 0, "longest": longest}),
    ]
    present = [(told, part(target, **arguments)) for value, told, target, arguments in stages if value]
    return [stage for _, stage in present], [told for told, _ in present]
