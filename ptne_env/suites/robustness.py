"""The suite robustness: random worlds unlike those of the catalogue, on which a good policy is never bad.

Every number of a world is drawn as in a Latin hypercube: each of 40 equal parts of its range holds one world. So every
seed has the same shares of large games, switching graphs, lossy channels and so on, in other combinations.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ptne_env.evaluation.tracks import Track
from ptne_env.shared.parts import FactorySpec
from ptne_env.suites.suite import Suite
from ptne_env.world.scenario import Scenario

WORLDS = 40

EPISODES = 8
"""Number of episodes of a world; large games, which take most of the time, have half as many."""

DRAWS = (
    *("clean", "players", "components", "steps", "deadline", "pace", "end"),  # the clock and the size
    *("game", "stiffness", "ratio", "asymmetry", "bend", "box", "size", "near", "start"),  # the game
    *("graph", "links", "modes", "dwell", "pool"),  # the graph
    *("bias", "noise", "tails", "late", "onset", "rounding", "loss", "burst", "delay", "range"),  # the channel
)
"""Names of the numbers that are drawn per world, each uniform in (0, 1)."""

part = FactorySpec.of


def robustness(seed: int = 1) -> Suite:
    """Return the suite of the 40 random worlds of a seed; that of seed 1 is published."""
    generator = np.random.default_rng(seed)
    parts = {name: generator.permutation(WORLDS) + generator.random(WORLDS) for name in DRAWS}
    tracks = []
    for world in range(WORLDS):
        drawn = {name: float(column[world]) / WORLDS for name, column in parts.items()}
        tracks.append(_track(f"world-{world + 1:02}", drawn, np.random.default_rng((seed, world))))
    return Suite("robustness" if seed == 1 else f"robustness-{seed}", tuple(tracks), EPISODES)


def _scale_log(unit: float, low: float, high: float) -> float:
    """Return the number at ``unit``, in (0, 1), of a logarithmic scale from low to high, with three digits."""
    return float(f"{low * (high / low) ** unit:.3g}")


def _maybe(unit: float, share: float, low: float, high: float) -> float:
    """Return a number from low to high in a ``share`` of the worlds, and 0 in the others."""
    return _scale_log(unit / share, low, high) if unit < share else 0.0


def _track(name: str, drawn: dict[str, float], generator: np.random.Generator) -> Track:
    """Return the world of some draws; the generator draws only links."""
    players = int(np.interp(drawn["players"], (0.0, 0.1, 0.8, 0.9, 1.0), (2, 3, 9, 20, 41)))
    game, largest, size, told = _game(players, drawn)
    links = _links(players, drawn["links"], generator)
    kind = ("fixed", "fixed", "episode", "physical", "transformed")[int(drawn["graph"] * 5)] if players > 2 else "fixed"
    probability = round(min(1.0, 1.5 * math.log(players + 1) / players), 2)
    degree = (players - 1) * probability if kind == "episode" else 2 * len(links) / players
    # The paper's law with κ = 2 is stable up to Θ = 2/(ι + 2 λ_max(L)), about; the steps are 0.25 to 0.8 of that.
    step = _scale_log(drawn["pace"], 0.5, 1.6) / (largest + 2 * min(players, degree + 3))
    wanted = _scale_log(drawn["steps"], 50, 2000)
    end = 5 + 2 * drawn["end"]
    steps = round(max(min(wanted, 6_000 / players), 1.2 * end / step))
    deadline = _scale_log(drawn["deadline"], 0.1, 10)
    gain = float(f"{max(steps * step - end, 0.2 * end) / deadline:.3g}")
    topology, change = _topology(kind, players, links, probability, drawn, (deadline, gain, end, steps))
    factor = _scale_log(drawn["start"], 0.01, 100)
    reach = float(f"{min(size * factor, 1000.0):.3g}")
    stages, troubles = _channel(size, steps, drawn)
    limit = float(f"{(3 + 2 * drawn['range']) * max(size, reach):.3g}") if drawn["range"] < 0.5 else None
    scenario = Scenario(
        name=name,
        game=game,
        topology=topology,
        start=part("start:uniform", low=-reach, high=reach),
        deadline=deadline,
        gain=gain,
        steps=steps,
        s_end=round(end, 2),
        channel=part("channel:chain", stages=stages),
        message_range=limit,
    )
    if limit is not None:
        troubles.append(f"range {limit:g}")
    sentence = (
        f"{players} players, {told}; {change}; T = {deadline:g}, {steps} steps; starts ±{reach:g}; "
        f"{', '.join(troubles) or 'a perfect channel'}."
    )
    return Track(name, scenario, sentence, episodes=EPISODES if players <= 12 else EPISODES // 2)


def _game(players: int, drawn: dict[str, float]) -> tuple[FactorySpec, float, float, str]:
    """Return a family of games, its largest curvature, the size of its equilibria or box, and a description."""
    stiffness, ratio = _scale_log(drawn["stiffness"], 0.3, 3), _scale_log(drawn["ratio"], 2, 200)
    kind = ("energy", "affine", "affine", "saturating")[int(drawn["game"] * 4)]
    size = _scale_log(drawn["size"], 0.3, 30)
    scale = float(f"{size * (_maybe(drawn['near'], 0.15, 0.001, 0.03) or 1.0):.3g}")
    low = float(f"{stiffness / math.sqrt(ratio):.3g}")
    near = f", equilibria ±{scale:g}"
    if kind == "energy":
        coupling = float(f"{low * players**-0.5:.3g}")
        arguments = {
            "curvature": (low, float(f"{low * ratio:.3g}")),
            "target": (-scale, scale),
            "coupling": (0.0, coupling),
            "base_price": 0.0,
        }
        largest = 2 * low * ratio + coupling * (1 + players)
        return part("game:random-energy", players=players, **arguments), largest, size, f"energy, ratio {ratio:g}{near}"
    dims = 1 if drawn["components"] < 0.7 or players > 8 else 2 + (drawn["components"] > 0.9)
    bend = _scale_log(drawn["bend"], 1, 20) if kind == "saturating" else 0.0
    ratio = min(ratio, 10.0) if bend else ratio
    box = drawn["box"] < 0.35 and not bend
    bounds = {"low": -float(f"{0.7 * scale:.3g}"), "high": float(f"{0.9 * scale:.3g}")} if box else {}
    affine = part(
        "game:random-affine",
        players=players,
        epsilon=low,
        spread=float(f"{low * (ratio - 1):.3g}"),
        asymmetry=float(f"{stiffness * drawn['asymmetry']:.3g}"),
        scale=scale,
        action_dim=dims,
        **bounds,
    )
    components = f" of {dims} components" * (dims > 1)
    if bend:
        saturating = part("game:random-saturating", affine=affine, bend=bend)
        return saturating, low * ratio + 3 * bend, size, f"saturating{components}, bend {bend:g}{near}"
    told = f"affine{components}, ratio {ratio:g}{' in a box' * box}{near}"
    return affine, low * ratio + stiffness * drawn["asymmetry"], size, told


def _links(players: int, unit: float, generator: np.random.Generator) -> list[tuple[int, int]]:
    """Return the links of a connected random graph: those of a random tree, and up to as many more."""
    order = generator.permutation(players).tolist()
    links = {tuple(sorted((order[i], order[int(generator.integers(i))]))) for i in range(1, players)}
    for _ in range(round(unit * players)):
        links.add(tuple(sorted(generator.choice(players, 2, replace=False).tolist())))
    return sorted((int(i), int(j)) for i, j in links)


def _topology(
    kind: str,
    players: int,
    links: list[tuple[int, int]],
    probability: float,
    drawn: dict[str, float],
    clock: tuple[float, float, float, int],
) -> tuple[FactorySpec, str]:
    """Return the topology of a kind, and its description; a switching one shares its links out to a few modes."""
    deadline, gain, end, steps = clock
    if kind == "fixed":
        return part("topology:edges", players=players, edges=links), "a fixed graph"
    if kind == "episode":
        seed = int(drawn["pool"] * 1e6)
        pool = part("topology:random-graphs", players=players, probability=probability, modes=20, seed=seed)
        return pool, "a random graph per episode"
    modes = 2 + int(drawn["modes"] * 3)
    graphs = [part("topology:edges", players=players, edges=links[mode::modes]) for mode in range(modes)]
    # The longest step but the last is at the start on the physical clock, and at the end on the transformed one.
    step = (end + gain * deadline) / steps
    shortest, whole = (step / (gain + 1 / deadline), deadline) if kind == "physical" else (step, end)
    dwell = _scale_log(drawn["dwell"], 2 * shortest, max(whole / (3 * modes), 3 * shortest))
    if kind == "physical":  # the last step goes on to the deadline, and may be the longest; other dwells stay
        dwell = max(dwell, float(f"{1.01 * deadline * math.exp(step - end):.3g}"))
    periodic = part("topology:periodic", graphs=graphs, dwells=[dwell] * modes, clock=kind)
    return periodic, f"{modes} graphs in turn on the {kind} clock"


def _channel(size: float, steps: int, drawn: dict[str, float]) -> tuple[list[FactorySpec], list[str]]:
    """Return the stages of a channel, with errors relative to the size of the game, and their descriptions."""
    if drawn["clean"] < 0.2:
        return [], []
    bias, noise, tails, late, rounding = (
        size * _maybe(drawn[name], share, low, high)
        for name, share, low, high in (
            ("bias", 0.2, 0.001, 0.03),
            ("noise", 0.3, 0.0001, 0.03),
            ("tails", 0.15, 0.0003, 0.01),
            ("late", 0.15, 0.0003, 0.03),
            ("rounding", 0.25, 0.001, 0.1),
        )
    )
    onset, longest = round(steps * (0.2 + 0.6 * drawn["onset"])), int(_maybe(drawn["delay"], 0.3, 2, 11))
    loss = _maybe(drawn["loss"], 0.25, 0.05, 0.6)
    lost = (f"loss {loss:.2g}", "channel:loss", {"probability": loss})
    if drawn["burst"] < 0.3:
        lost = (f"loss {loss:.2g} in bursts", "channel:bursts", {"to_bad": 0.1 * loss / (1 - loss), "to_good": 0.1})
    candidates = (
        (bias, f"bias {bias:.2g}", "channel:bias", {"bound": bias}),
        (noise, f"noise {noise:.2g}", "channel:noise", {"std": noise}),
        (tails, f"heavy tails {tails:.2g}", "channel:heavy-tails", {"scale": tails}),
        (late, f"noise {late:.2g} from step {onset}", "channel:late-noise", {"std": late, "step": onset}),
        (rounding, f"rounding {rounding:.2g}", "channel:rounding", {"width": rounding}),
        (loss, *lost),
        (longest, f"delay 0 to {longest}", "channel:delay", {"steps": 0, "longest": longest}),
    )
    drawn_stages = [(told, _stage(target, arguments)) for value, told, target, arguments in candidates if value]
    return [stage for _, stage in drawn_stages], [told for told, _ in drawn_stages]


def _stage(target: str, arguments: dict[str, Any]) -> FactorySpec:
    """Return a stage whose numbers have three digits."""
    return part(target, **{name: float(f"{v:.3g}") if isinstance(v, float) else v for name, v in arguments.items()})
