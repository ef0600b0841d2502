"""Imitation of hand-written laws on the states that the network itself visits (dataset aggregation, DAgger).

In every round network and law play side by side: a share of the episodes follows the law's gates, which falls from all
in the first round to none in the last. Of every state the law says what it would have done, and the network regresses
on that. Each round has new data only, since a round is large beside the network.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from torch.nn.functional import huber_loss

from ptne_env.evaluation.workers import Workers
from ptne_env.field.laws.gated import CellGates, SlotGates
from ptne_env.learn.size_free import HIGH, LOW
from ptne_env.learn.training.actor import effects
from ptne_env.learn.training.cells import CELL_GATES, SLOT_GATES, CellBatch
from ptne_env.learn.training.network import GateNetwork
from ptne_env.shared.arrays import Float32Array, FloatArray
from ptne_env.world.scenario import Scenario

MARGIN = 1.0
"""By so much answers should pass a bound that the law's gate has, so that errors leave it there.

Near the end of an episode nothing corrects a wrong gate: where messages are rounded to steps of 0.5, a share of 0.95 in
place of 1 in the last step costs a digit. Evolution after imitation moves weights that its worlds hardly judge at
random, by about 0.05 each with the defaults of :class:`~ptne_env.learn.training.generalist.Generalist`, and answers by about
0.15.
"""

NARROW_MARGIN = 0.25
"""The margin of the gates that the law also keeps between their bounds: a wide margin makes them steep."""

_BETWEEN = ("copies", "step", "mean")
"""These gates."""

_SHARPNESS = 0.03
"""Errors above this cost in proportion: a weight of 0.06 in place of 0.09 matters, and its square is small."""

Samples = tuple[Float32Array, Float32Array, Float32Array, Float32Array]
"""Features of cells and of their slots, and the law's gates of both."""


def imitate(
    network: GateNetwork,
    optimizer: torch.optim.Optimizer,
    tasks: Sequence[tuple[Scenario, GateNetwork]],
    share: float,
    generator: np.random.Generator,
    workers: Workers | None = None,
    *,
    episodes: int = 8,
    samples: int = 4000,
    epochs: int = 4,
    minibatch: int = 1024,
) -> float:
    """One round.

    Args:
        network: learns.
        optimizer: of its parameters.
        tasks: worlds, each with the law that is imitated there.
        share: of the episodes that follow the law.
        generator: of episodes, samples and minibatches.
        workers: play the worlds side by side; one after the other if left out.
        episodes: in each world.
        samples: cells of each world, of all its steps.
        epochs: passes over the samples of the round.
        minibatch: cells of one world per step of the optimiser.

    Returns:
        The mean digits at the end of the episodes that the network plays; NaN where all follow the law.
    """
    seeds = generator.integers(2**62, size=len(tasks)).tolist()
    plays = [(network, *task, share, seed, episodes, samples) for task, seed in zip(tasks, seeds, strict=True)]
    data, digits = zip(*(workers or Workers()).gather(_play, plays), strict=True)
    for _ in range(epochs):
        places = [(index, rows) for index, each in enumerate(data) for rows in _minibatches(each, generator, minibatch)]
        for order in generator.permutation(len(places)):
            index, rows = places[order]
            loss = _loss(network, *(torch.from_numpy(part[rows]) for part in data[index]))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    own = np.concatenate(digits)
    return float(own.mean()) if own.size else float("nan")


def _minibatches(samples: Samples, generator: np.random.Generator, size: int) -> Iterator[np.ndarray]:
    order = generator.permutation(len(samples[0]))
    yield from np.array_split(order, max(len(order) // size, 1))


def _play(
    network: GateNetwork,
    scenario: Scenario,
    law: GateNetwork,
    share: float,
    seed: int,
    episodes: int,
    samples: int,
) -> tuple[Samples, FloatArray]:
    """Cells of a world, drawn evenly from all steps of episodes that network and law play; digits of the network's."""
    batch, generator = CellBatch(scenario, episodes), np.random.default_rng(seed)
    batch.start(generator.integers(2**62, size=episodes).tolist())
    is_law = np.arange(episodes) < round(share * episodes)
    follows = np.repeat(is_law, batch.cells // episodes)
    taken: list[Samples] = []
    while not batch.is_over:
        cell, slot = batch.features()
        wanted, answers = law.decide(cell, slot), network.decide(cell, slot)
        count = min(-(-samples // batch.world.clock.total_steps), batch.cells)
        rows = generator.choice(batch.cells, count, replace=False)
        taken.append((cell[rows], slot[rows], wanted[0][rows], wanted[1][rows]))
        mine = np.where(follows[:, None], wanted[0], answers[0])
        theirs = np.where(follows[:, None, None], wanted[1], answers[1])
        batch.step(*batch.as_gates(mine, theirs))
    cells, slots, gates, slot_gates = (np.concatenate(parts) for parts in zip(*taken, strict=True))
    return (cells, slots, gates, slot_gates), batch.digits.mean(axis=0)[~is_law]


def _loss(
    network: GateNetwork, cell: torch.Tensor, slot: torch.Tensor, gates: torch.Tensor, slot_gates: torch.Tensor
) -> torch.Tensor:
    """Mean loss of the gates that have an effect. An answer beyond the bound at which the law is has none."""
    mine, theirs = network(cell, slot)
    acts = effects(cell, slot).split([CELL_GATES, slot.shape[1] * SLOT_GATES], dim=1)
    losses = [
        huber_loss(answer, _target(answer, wanted, fields), reduction="none", delta=_SHARPNESS).flatten(1) * act
        for answer, wanted, fields, act in zip(
            (mine, theirs), (gates, slot_gates), (CellGates._fields, SlotGates._fields), acts, strict=True
        )
    ]
    return sum(loss.sum() for loss in losses) / _SHARPNESS / sum(act.sum() for act in acts)


def _target(answer: torch.Tensor, wanted: torch.Tensor, fields: tuple[str, ...]) -> torch.Tensor:
    high = torch.tensor([HIGH[name] for name in fields])
    margin = torch.tensor([NARROW_MARGIN if name in _BETWEEN else MARGIN for name in fields])
    target = wanted.clamp(torch.tensor(LOW), high)
    target = torch.where(wanted >= high, torch.maximum(answer.detach(), high + margin), target)
    return torch.where(wanted <= LOW, torch.minimum(answer.detach(), LOW - margin), target)
