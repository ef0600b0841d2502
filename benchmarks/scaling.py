"""Cost of an agent-step by players, neighbours and environments, beside its least operations and bytes."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np

from benchmarks import ours
from benchmarks.timing import Contender, Plan, Spread, interleave
from ptne_env.envs.vector import VectorParallelEnv
from ptne_env.factory import FactorySpec
from ptne_env.observation import ObservationLayout
from ptne_env.scenario import Scenario

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
            "ptne_env.switching:fixed", graph=FactorySpec.of(f"ptne_env.graphs:{graph}", players=players)
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
    """Cost of an agent-step by N and graph, as rows of a table."""
    rows: list[dict[str, Any]] = []
    contenders: list[Contender] = []
    for players in (5, 10) if plan.quick else (5, 10, 20, 50, 100):
        for graph in ("cycle", "complete"):
            world = scenario(players, graph)
            layout = VectorParallelEnv(world, 1).layout
            batch = min(_ENVIRONMENTS, _ENTRIES // (layout.slots * players * players))
            batch = 4 if plan.quick else max(1, batch)
            contender = ours.vector("physical", batch, world)
            contenders.append(Contender(world.name, contender.agent_steps, contender.step))
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
    rates = interleave(contenders, plan)
    for row, contender in zip(rows, contenders, strict=True):
        rate = Spread.of(rates[contender.name])
        row["agent_steps_per_second"] = rate.to_dict()
        row["nanoseconds_per_agent_step"] = 1e9 / rate.median
        row["operations_per_second"] = row["operations"] * rate.median
        row["bytes_per_second"] = row["bytes"] * rate.median
    return rows


def over_batch(plan: Plan) -> list[dict[str, Any]]:
    """Cost of an agent-step and memory by B, N = 5, for both interfaces, as rows of a table."""
    sizes = (1, 16) if plan.quick else (1, 4, 16, 64, 256, 1024, 2048, 4096, 8192, 16384)
    rows: list[dict[str, Any]] = []
    for kind in ("physical", "local"):
        contenders = []
        for size in sizes:
            contender = ours.vector(kind, size)
            contenders.append(Contender(str(size), contender.agent_steps, contender.step))
        rates = interleave(contenders, plan)
        for size in sizes:
            rate = Spread.of(rates[str(size)])
            rows.append(
                {
                    "interface": kind,
                    "envs": size,
                    "agent_steps_per_second": rate.to_dict(),
                    "nanoseconds_per_agent_step": 1e9 / rate.median,
                    "bytes_per_env": ours.memory(kind, size),
                }
            )
    return rows
