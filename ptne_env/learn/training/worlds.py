"""Random worlds for training: players, games, graphs, times and faults, drawn beside those of the published suites.

The tracks of ptne-v1 and ptne-v2 are tests, so no world is one of them by construction. The constants of this module
are all that is drawn, and all that is held out. Graphs of tracks cannot occur, because no world has their numbers of
players. Not held out is what most worlds share with some track: the families RandomAffine, RandomEnergy and
RandomSaturating, the kinds of topologies and faults, s_end, the range of starts, and densities of random graphs.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from ptne_env.evaluation.episodes import Split, track_seed
from ptne_env.shared.arrays import require_count
from ptne_env.shared.parts import FactorySpec
from ptne_env.world.clock import Exponential, StepClock
from ptne_env.world.scenario import Scenario


class Levels(NamedTuple):
    """The levels of one quantity: log-uniform in a range, without the bands around the levels of tracks.

    Attributes:
        low, high: the range.
        held_out: the levels of tracks.
        band: factor b > 1; levels between h/b and b h are held out for every h in ``held_out``.
        is_whole: whether levels are whole numbers.
    """

    low: float
    high: float
    held_out: tuple[float, ...] = ()
    band: float = 1.25
    is_whole: bool = False

    def allows(self, level: float) -> bool:
        """Whether a level lies in the range and in no band."""
        in_band = any(known / self.band < level < known * self.band for known in self.held_out)
        return self.low <= level <= self.high and not in_band


PLAYERS = (3, 4, 7, 8, 10, 11, 12)
"""Numbers of players, which no track has."""

GAMES = {
    "RandomAffine": (0.3, -20.0, 20.0),
    "RandomEnergy": (0.2, -20.0, 20.0),
    "RandomSaturating": (0.14, -20.0, 20.0),
    "Oligopoly": (0.06, 20.0, 60.0),
    "NetworkedCournot": (0.06, 0.0, 6.0),
    "ElectricVehicleCharging": (0.06, 0.0, 2.0),
    "RateControl": (0.06, 0.0, 4.0),
}
"""Games and families by name: their share, and the range of the estimates at the start."""

BOXED_GAMES = ("NetworkedCournot", "ElectricVehicleCharging", "RateControl")
"""Games with a box, which cannot drift."""

HELD_OUT_GAMES = frozenset(
    {"ConnectivityControl", "CoupledConstraint", "NonQuadraticGame", "WeaklyMonotoneGame"}
)
"""Games and families of tracks that no world has."""

SWITCHING = ("periodic", "random_dwells", "markov", "random_edges")
"""Topologies that switch; the others are one graph, and one graph for every episode."""

STAGES = {"OneWayLinks": 0.08, "Lying": 0.08, "Delay": 0.08, "Loss": 0.08, "BurstLoss": 0.08, "UniformQuantiser": 0.2}
STAGES |= {"AdditiveNoise": 0.4}
"""Stages of channels in their order, and their shares."""

STAGE_COUNTS = (0.33, 0.46, 0.14, 0.07)
"""Shares of channels with 0 (perfect), 1, 2 and 3 stages."""

DIFFICULTIES = {"switching": 0.35, "sensor": 0.13, "limit": 0.13, "drift": 0.13, "pushes": 0.13, "clocks": 0.13}
"""Difficulties beside the channel, and their shares."""

DIFFICULTY_COUNTS = (0.4, 0.45, 0.15)
"""Shares of worlds with 0, 1 and 2 of them."""

LEVELS = {
    # The time of an episode; the effective time, s_end + c T, is at most 68.
    "deadline": Levels(0.05, 2.0, (0.12, 0.3, 1.2)),
    "gain": Levels(2.0, 30.0, (5.0, 20.0)),
    "s_end": Levels(4.7, 8.0),
    "steps": Levels(40, 380, (30, 100, 150, 200, 300, 400), band=1.05, is_whole=True),
    # Topologies: mean dwells until the deadline, and the probability that a link is up.
    "dwells": Levels(8.0, 48.0, (12.0, 24.0, 60.0)),
    "link_probability": Levels(0.2, 0.9, (0.4,)),
    # Channels, in units of strategies, steps and probabilities.
    "noise": Levels(1e-5, 0.3, (1e-8, 0.001, 0.05)),
    "delay": Levels(1, 12, (7,), is_whole=True),
    "loss": Levels(0.05, 0.5),
    "to_bad": Levels(0.01, 0.2, (0.05,)),
    "to_good": Levels(0.03, 0.5, (0.1,)),
    "rounding": Levels(0.01, 1.0, (0.1, 0.5)),
    "one_way_share": Levels(0.1, 1.0, (0.5,)),
    "lie": Levels(0.1, 4.0, (1.0,)),
    # Gradients, inputs, the amplitude of a drift and its period in units of T.
    "sensor": Levels(1e-3, 0.1, (0.01,)),
    "input_limit": Levels(1.0, 30.0, (1.8, 2.0)),
    "amplitude": Levels(1.0, 15.0, (5.0,)),
    "period": Levels(0.4, 4.0, (1 / 1.2,)),
    # Velocities of pushes, the steps that each lasts, the steps after the deadline, the largest clock shift over T.
    "push": Levels(0.3, 15.0, (1.0, 5.0)),
    "push_steps": Levels(1, 40, (10, 25), is_whole=True),
    "hold_steps": Levels(20, 90, (50, 100), is_whole=True),
    "clock_shift": Levels(0.01, 0.3, (0.2 / 1.2,)),
}
"""Levels of all faults and times, and those of tracks, which are held out."""

_REACH, _LARGEST_PUSH = 45.0, 0.1
"""Least way that inputs can move a strategy in an episode, and largest way that pushes move it in a step."""

_LONGEST_DELAY = 0.04
"""Longest delay, as a share of the steps."""


def training_world(seed: int, index: int, split: Split = "train") -> Scenario:
    """A random scenario, which depends on the arguments alone; splits share no stream.

    Worlds differ in their numbers of players and components, so their layouts differ too. Most have up to two
    difficulties, an imperfect channel among them.

    Args:
        seed: of all worlds, below 2^32.
        index: of the world, below 2^32.
        split: worlds of different splits are different draws of one distribution.

    Returns:
        The scenario ``"SPLIT-INDEX"``.

    Raises:
        ValueError: when the split is unknown, or a number is negative or not below 2^32.
    """
    generator = np.random.default_rng(track_seed("training", "worlds", split, seed, index))
    players = int(generator.choice(PLAYERS))
    (game,) = _names(generator, {name: share for name, (share, _, _) in GAMES.items()}, 1)
    difficulties = _names(generator, DIFFICULTIES, generator.choice(len(DIFFICULTY_COUNTS), p=DIFFICULTY_COUNTS))
    draw_topology = _switching if "switching" in difficulties else _resting
    topology, time = draw_topology(generator, players)
    fields: dict[str, Any] = {}
    for name in difficulties:
        if name != "switching" and (name != "drift" or game not in BOXED_GAMES):
            fields |= _difficulty(generator, name, players, **time)
    _, low, high = GAMES[game]
    return Scenario(
        name=f"{split}-{index}",
        game=_game(generator, game, players),
        topology=topology,
        start=_part("starts", "UniformStart", low=low, high=high),
        channel=_channel(generator, time["steps"]),
        **time,
        **fields,
    )


def training_worlds(seed: int, count: int, split: Split = "train") -> tuple[Scenario, ...]:
    """The first ``count`` worlds of a seed and a split.

    Raises:
        ValueError: when the count is below 1, or as :func:`training_world`.
    """
    return tuple(training_world(seed, index, split) for index in range(require_count("count", count, 1)))


def _part(module: str, name: str, **arguments: Any) -> FactorySpec:
    return FactorySpec.of(f"ptne_env.{module}:{name}", **arguments)


def _names(generator: np.random.Generator, shares: dict[str, float], count: int) -> list[str]:
    """Different names, drawn one after the other by their shares, in the order of the table."""
    drawn = set(generator.choice(list(shares), size=count, replace=False, p=list(shares.values())).tolist())
    return [name for name in shares if name in drawn]


def _level(generator: np.random.Generator, name: str, low: float = 0.0, high: float = math.inf) -> float:
    """A level of the table, within narrower limits where they are given; no band covers them."""
    levels = LEVELS[name]
    low, high = max(low, levels.low), min(high, levels.high)
    while True:
        level = math.exp(generator.uniform(math.log(low), math.log(high)))
        level = round(level) if levels.is_whole else level
        if levels.allows(level):
            return level


def _game(generator: np.random.Generator, name: str, players: int) -> FactorySpec:
    """A family of games, or a market, whose total coupling does not grow with the number of players."""
    number, numbers = generator.uniform, partial(generator.uniform, size=players)
    is_even, crowd = generator.random() < 0.5, 5 / players
    affine = {
        "players": players,
        "action_dim": int(generator.integers(1, 4)) if is_even else generator.integers(1, 4, players),
        "epsilon": number(0.4, 2.0),  # 0 is weakly monotone, which tracks are
        "asymmetry": number(0.0, 2.0),
        "spread": number(0.5, 4.0),
    }
    arguments: dict[str, dict[str, Any]] = {
        "RandomAffine": affine,
        "RandomSaturating": {"affine": _part("games", "RandomAffine", **affine), "bend": number(0.5, 6.0)},
        "RandomEnergy": {"players": players, "coupling": number(0.5, 4.0) * crowd * np.array([0.05, 0.3])},
        "Oligopoly": {"preference": numbers(0.15, 1.0), "marginal_cost": numbers(20.0, 30.0)},
        "NetworkedCournot": {
            "links": [sorted({firm % 3, *generator.integers(3, size=2).tolist()}) for firm in range(players)],
            "slope": crowd * number(0.4, 0.6, 3),
            "curvature": numbers(0.5, 0.9),
            "marginal_cost": numbers(2.0, 8.0),
            "capacity": numbers(3.0, 6.0),
        },
        "ElectricVehicleCharging": {
            "energy": numbers(3.0, 6.0),
            "base_load": number(1.0, 8.0, generator.choice([2, 3])),
            "price": crowd * number(0.05, 0.15),
        },
        "RateControl": {
            "routes": [sorted({user % 3, int(generator.integers(3))}) for user in range(players)],
            "utility": numbers(6.0, 10.0),
            "congestion": crowd * number(0.3, 0.5, 3),
            "limit": numbers(2.0, 4.0),
        },
    }
    return _part("games", name, **arguments[name])


def _links(generator: np.random.Generator, players: int) -> list[list[int]]:
    """The links of a connected graph in random order: a random tree, and all other pairs with one probability."""
    order = generator.permutation(players).tolist()
    tree = [sorted((order[place], order[generator.integers(place)])) for place in range(1, players)]
    density = generator.uniform(0.0, 0.5)
    others = [[*pair] for pair in combinations(range(players), 2) if [*pair] not in tree]
    links = tree + [pair for pair in others if generator.random() < density]
    return [links[place] for place in generator.permutation(len(links))]


def _graph(players: int, links: list[list[int]]) -> FactorySpec:
    return _part("graphs", "from_edges", players=players, edges=links)


def _time(generator: np.random.Generator) -> dict[str, Any]:
    return {name: _level(generator, name) for name in ("deadline", "gain", "s_end", "steps")}


def _resting(generator: np.random.Generator, players: int) -> tuple[FactorySpec, dict[str, Any]]:
    """One graph, or one for every episode; and the fields of time."""
    fixed = _part("switching", "fixed", graph=_graph(players, _links(generator, players)))
    probability, seed = generator.uniform(math.log(players) / players, 0.8), generator.integers(2**32)
    drawn = _part("switching", "random_graphs", players=players, probability=probability, seed=seed)
    return (fixed if generator.random() < 0.5 else drawn), _time(generator)


def _switching(generator: np.random.Generator, players: int) -> tuple[FactorySpec, dict[str, Any]]:
    """Graphs that take turns and need not be connected; and the fields of a time whose steps resolve their dwells."""
    clock, count = str(generator.choice(["physical", "transformed"])), _level(generator, "dwells")
    width, dwell, longest_step = generator.uniform(0.0, 0.6), 0.0, math.inf
    while longest_step > (1 - width) * dwell:
        time = _time(generator)
        grid = {name: time[name] for name in ("gain", "steps", "s_end")}
        # One step after the deadline is as long as all that may follow.
        instants = StepClock(Exponential(time["deadline"]), **grid, hold_steps=1).topology_times[clock]
        dwell, longest_step = instants[time["steps"]] / count, np.diff(instants).max()
    links, modes = _links(generator, players), int(generator.integers(2, 5))
    graphs = [_graph(players, links[mode::modes]) for mode in range(modes)]
    between = ((1 - width) * dwell, (1 + width) * dwell)
    pool = {"graph": _graph(players, links), "modes": 64, "seed": generator.integers(2**32)}
    arguments: dict[str, dict[str, Any]] = {
        "periodic": {"graphs": graphs, "dwells": generator.permutation(np.linspace(*between, modes))},
        "random_dwells": {"graphs": graphs, "dwells": between},
        "markov": {"graphs": graphs, "dwells": between, "transition": generator.dirichlet(np.full(modes, 3.0), modes)},
        "random_edges": {**pool, "dwells": between, "probability": _level(generator, "link_probability")},
    }
    kind = str(generator.choice(SWITCHING))
    return _part("switching", kind, clock=clock, **arguments[kind]), time


def _channel(generator: np.random.Generator, steps: int) -> FactorySpec:
    """A chain of no, one or several stages, for episodes of so many steps."""
    gap, target = str(generator.choice(["hold", "drop"])), str(generator.choice(["message", "difference"]))
    arguments: dict[str, dict[str, Any]] = {
        "OneWayLinks": {"share": _level(generator, "one_way_share")},
        "Lying": {"size": _level(generator, "lie")},
        "Delay": {"steps": 1, "longest": _level(generator, "delay", high=_LONGEST_DELAY * steps)},
        "Loss": {"probability": _level(generator, "loss"), "gap": gap},
        "BurstLoss": {"to_bad": _level(generator, "to_bad"), "to_good": _level(generator, "to_good"), "gap": gap},
        "UniformQuantiser": {"width": _level(generator, "rounding"), "target": target},
        "AdditiveNoise": {"std": _level(generator, "noise")},
    }
    names = _names(generator, STAGES, generator.choice(len(STAGE_COUNTS), p=STAGE_COUNTS))
    stages = [_part("channel", name, **arguments[name]) for name in names]
    return _part("channel", "Chain", stages=stages) if stages else _part("channel", "perfect")


def _difficulty(
    generator: np.random.Generator, name: str, players: int, deadline: float, gain: float, s_end: float, steps: int
) -> dict[str, Any]:
    """The fields that one difficulty changes."""
    effective_time = s_end + gain * deadline
    longest_hold_step = effective_time / (gain * steps)
    push = _level(generator, "push", high=_LARGEST_PUSH / longest_hold_step)
    pushes = {"bound": push, "dwell": _level(generator, "push_steps"), "after_deadline_only": True}
    swing = {"amplitude": _level(generator, "amplitude"), "period": deadline * _level(generator, "period")}
    shifts = generator.uniform(-1.0, 1.0, players)
    shifts *= deadline * _level(generator, "clock_shift") / np.abs(shifts).max()
    changes: dict[str, dict[str, Any]] = {
        "sensor": {"sensor": _part("sensor", "GradientNoise", std=_level(generator, "sensor"))},
        "limit": {"input_limit": _level(generator, "input_limit", low=_REACH / effective_time)},
        "drift": {"drift": _part("drift", "Sinusoid", **swing)},
        "pushes": {
            "disturbance": _part("disturbances", "UniformDisturbance", **pushes),
            "hold_steps": _level(generator, "hold_steps"),
        },
        "clocks": {"clock_shifts": shifts.tolist()},
    }
    return changes[name]
