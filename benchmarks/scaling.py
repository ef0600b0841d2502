"""Cost of an agent-step by players, neighbours and environments, beside its least operations and bytes."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks import ours
from benchmarks.timing import Contender, Plan, Spread, interleave
from ptne_env.envs.vector import VectorParallelEnv
from ptne_env.perception.observation import ObservationLayout
from ptne_env.shared.parts import FactorySpec
from ptne_env.world.scenario import Scenario

_ENTRIES = 2_000_000
"""Largest number of relative estimates D n N B of a batch, so that large worlds fit into memory."""

_ENVIRONMENTS = 1024
"""Largest batch in the table over players."""


def scenario(players: int, graph: str) -> Scenario:
    """Random energy games of ``players`` on a ``cycle`` or ``complete`` graph.

    The input limit is so small that random play stays in range for every N.
    """
    return Scenario(
        name=f"{graph}-{players}",
        game=FactorySpec.of("ptne_env.games:RandomEnergy", players=players),
        topology=FactorySpec.of(
            "ptne_env.world.switching:fixed", graph=FactorySpec.of(f"ptne_env.world.graphs:{graph}", players=players)
        ),
        start="random",  # type: ignore[arg-type]  # a short name
        input_limit=100.0,
    )


def arithmetic(layout: ObservationLayout) -> int:
    """Additions, multiplications and comparisons that one agent-step of an energy game needs, interface ``physical``.

    Per component: 2 to move the estimate, 1 for the gradient's sum, 3 for the distance, 2 to stay in range, 2 to
    check the action and D for the relative estimates; and about 20 for the rest, of which the logarithm is most.
    """
    return (10 + layout.slots) * layout.dimension + 20


def traffic(layout: ObservationLayout) -> int:
    """Least bytes that one agent-step moves, if every array is read and written once.

    The action is read (float32), the estimate read and written (float64), the observation written (float32) and the
    reward written (float64). The estimate of a neighbour is counted as that player's own.
    """
    return 4 * layout.action_size + 16 * layout.dimension + 4 * layout.size + 8


def copy_of(layout: ObservationLayout, num_envs: int) -> Contender:
    """A copy by numpy that reads and writes as many bytes as a step of ``num_envs`` environments: see :func:`traffic`.

    No step that touches every array in memory once can be faster.
    """
    agents = num_envs * layout.num_players
    source = np.zeros(agents * traffic(layout) // 2, dtype=np.uint8)
    target = np.empty_like(source)
    return Contender("a copy of the bytes of a step", agents, lambda: np.copyto(target, source))


def copy_speed(plan: Plan) -> Spread:
    """Bytes per second, read and written, at which numpy copies an array larger than the second cache."""
    source = np.zeros(1 << (20 if plan.quick else 24), dtype=np.float64)
    target = np.empty_like(source)
    np.copyto(target, source)
    rates = []
    for _ in range(plan.repeats):
        began = perf_counter()
        np.copyto(target, source)
        rates.append(2 * source.nbytes / (perf_counter() - began))
    return Spread.of(rates)


def over_players(plan: Plan) -> list[dict[str, Any]]:
    """Cost of an agent-step by N and graph, compiled and by numpy, as rows of a table."""
    rows: list[dict[str, Any]] = []
    contenders: list[Contender] = []
    for players in (5, 10) if plan.quick else (5, 10, 20, 50, 100):
        for graph in ("cycle", "complete"):
            world = scenario(players, graph)
            layout = VectorParallelEnv(world, 1).layout
            batch = min(_ENVIRONMENTS, _ENTRIES // (layout.slots * players * players))
            batch = 4 if plan.quick else max(1, batch)
            contenders += _both(world.name, ours.vector("physical", batch, world))
            rows.append(
                {
                    "players": players,
                    "graph": graph,
                    "neighbours": layout.slots,
                    "envs": batch,
                    "observation": layout.size,
                    "operations": arithmetic(layout),
                    "bytes": traffic(layout),
                }
            )
    rates = interleave(contenders, _shorter(plan))
    for row in rows:
        name = f"{row['graph']}-{row['players']}"
        rate = Spread.of(rates[name])
        row["agent_steps_per_second"] = rate.to_dict()
        row["nanoseconds_per_agent_step"] = 1e9 / rate.median
        row["nanoseconds_by_numpy"] = 1e9 / Spread.of(rates[f"{name}, numpy"]).median
        row["operations_per_second"] = row["operations"] * rate.median
        row["bytes_per_second"] = row["bytes"] * rate.median
    return rows


def _both(name: str, contender: Contender) -> list[Contender]:
    """The contender under another name, with compiled steps and with numpy's."""
    named = replace(contender, name=name)
    return [ours.by("compiled", named), ours.by("numpy", named)]


def _shorter(plan: Plan) -> Plan:
    """Half the time for each turn, because nothing here is compared with a target."""
    return replace(plan, seconds=plan.seconds / 2)


def over_batch(plan: Plan) -> list[dict[str, Any]]:
    """Cost of an agent-step and memory by B, N = 5, both ways and for both interfaces, as rows of a table."""
    sizes = (1, 16) if plan.quick else (1, 4, 16, 64, 256, 1024, 2048, 4096, 8192, 16384)
    rows: list[dict[str, Any]] = []
    for kind in ("physical", "scaled"):
        contenders = [each for size in sizes for each in _both(str(size), ours.vector(kind, size))]
        rates = interleave(contenders, _shorter(plan))
        for size in sizes:
            rate = Spread.of(rates[str(size)])
            memory = {}
            paths: tuple[ours.StepPath, ...] = ("numpy", "compiled")
            for path in paths:
                ours.use(path)
                memory[path] = ours.memory(kind, size)
            rows.append(
                {
                    "interface": kind,
                    "envs": size,
                    "agent_steps_per_second": rate.to_dict(),
                    "nanoseconds_per_agent_step": 1e9 / rate.median,
                    "nanoseconds_by_numpy": 1e9 / Spread.of(rates[f"{size}, numpy"]).median,
                    "bytes_per_env": memory["compiled"],
                    "bytes_per_env_by_numpy": memory["numpy"],
                }
            )
    return rows
