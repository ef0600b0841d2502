"""Search for the weights of a gate network by CMA-ES with a diagonal covariance, on what episodes score.

All networks of a generation play the same episodes of the same worlds, side by side in one batch of cells, so that
their scores differ by their weights alone and a generation costs little more than its arithmetic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
import torch
from torch.func import functional_call, vmap

from ptne_env.learn.training.cells import CellBatch
from ptne_env.learn.training.network import GateNetwork
from ptne_env.shared.arrays import FloatArray
from ptne_env.world.scenario import Scenario

LINEAR = ("cell_skip.weight", "cell_skip.bias", "slot_skip.weight", "slot_skip.bias")
"""The parameters of the linear maps beside the layers."""


def vector(network: GateNetwork, names: Sequence[str]) -> FloatArray:
    """Parameters by name as one vector of float64."""
    parameters = dict(network.named_parameters())
    return np.concatenate([parameters[name].detach().double().numpy().ravel() for name in names])


def parameters(network: GateNetwork, names: Sequence[str], vectors: FloatArray) -> dict[str, torch.Tensor]:
    """The inverse of :func:`vector` for P vectors, shape (P, k): tensors with P first."""
    shapes = [dict(network.named_parameters())[name].shape for name in names]
    ends = np.cumsum([shape.numel() for shape in shapes])
    parts = np.split(vectors.astype(np.float32), ends[:-1], axis=1)
    return {
        name: torch.from_numpy(part).reshape(-1, *shape) for name, shape, part in zip(names, shapes, parts, strict=True)
    }


@lru_cache(maxsize=256)
def _batch(scenario: Scenario, episodes: int) -> CellBatch:
    return CellBatch(scenario, episodes)


def scores(
    network: GateNetwork, names: Sequence[str], vectors: FloatArray, scenario: Scenario, seeds: Sequence[int]
) -> FloatArray:
    """Mean digits of P networks on the same episodes of a world, shape (P,).

    Digits are those at the deadline; where episodes go on after it, the mean of these and those at the end.

    Args:
        network: gives the parameters that are not named.
        names: of the parameters that differ.
        vectors: their values, shape (P, k).
        scenario: of the world.
        seeds: of the episodes.
    """
    population = len(vectors)
    stacked = parameters(network, names, vectors)
    rest = {name: each.detach() for name, each in network.named_parameters() if name not in stacked}

    def answer(own: Mapping[str, torch.Tensor], cell: torch.Tensor, slot: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return functional_call(network, {**rest, **own}, (cell, slot))

    batch = _batch(scenario, population * len(seeds))
    batch.start([seed for _ in range(population) for seed in seeds])
    decide = vmap(answer, in_dims=(0, 0, 0))
    clock, at_deadline = batch.world.clock, batch.digits
    with torch.inference_mode():
        for step in range(clock.total_steps):
            cell, slot = (torch.from_numpy(each).reshape(population, -1, *each.shape[1:]) for each in batch.features())
            mine, theirs = decide(stacked, cell, slot)
            batch.step(*batch.as_gates(mine.flatten(0, 1).numpy(), theirs.flatten(0, 1).numpy()))
            if step + 1 == clock.steps:
                at_deadline = batch.digits
    score = (at_deadline + batch.digits).mean(axis=0) / 2
    return score.reshape(population, len(seeds)).mean(axis=1)


def utility(digits: FloatArray) -> FloatArray:
    """What a generation is ranked by: digits above the median of each world, at most one up or down, mean over worlds.

    In worlds where the best networks reach twelve digits others lose ten of them, which would outweigh all that is won
    elsewhere.

    Args:
        digits: by world and network, shape (W, P).

    Returns:
        By network, shape (P,).
    """
    return np.clip(digits - np.median(digits, axis=1, keepdims=True), -1.0, 1.0).mean(axis=0)


def write(network: GateNetwork, names: Sequence[str], values: FloatArray) -> None:
    """Write a vector of parameters into a network."""
    own = dict(network.named_parameters())
    with torch.no_grad():
        for name, tensor in parameters(network, names, values[None]).items():
            own[name].copy_(tensor[0])


class Search:
    """CMA-ES with a diagonal covariance, after generations whose scores are known.

    It is replayed from these scores, so that it needs no state of its own.

    Args:
        start: the vector at which the search starts.
        sigma: initial standard deviation.
        population: vectors in a generation.
        seed: of the vectors.
        scores: of the generations so far, the higher the better.

    Raises:
        ImportError: when the package cma is missing.
    """

    def __init__(
        self, start: FloatArray, sigma: float, population: int, seed: int, scores: Sequence[Sequence[float]]
    ) -> None:
        try:
            from cma import CMAEvolutionStrategy
        except ImportError as error:
            raise ImportError('evolution needs an extra: pip install "ptne-env[sb3]"') from error
        generator = np.random.default_rng(seed)
        options = {
            "CMA_diagonal": True,
            "popsize": population,
            "seed": np.nan,
            "randn": lambda *size: generator.standard_normal(size),
            "verbose": -9,
        }
        self._search = CMAEvolutionStrategy(start, sigma, options)
        for each in scores:
            self._search.tell(self._search.ask(), [-score for score in each])

    def ask(self) -> FloatArray:
        """The vectors of the next generation, shape (P, k)."""
        return np.array(self._search.ask())

    @property
    def favourite(self) -> FloatArray:
        """The mean of the distribution, shape (k,)."""
        return np.array(self._search.result.xfavorite)
