"""Features beside the observation: products in which a good input is nearly linear."""

from __future__ import annotations

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from ptne_env.perception.observation import ObservationLayout


class Products(BaseFeaturesExtractor):
    """The observation, and its gradient and relative estimates once more per gate, multiplied by the gate.

    The gates are the weights of the neighbour slots and the player's one-hot. A good input is about linear in gradient
    and relative estimates, with coefficients that depend on the player and on its live links. In the products that is
    one linear map, which tanh layers on the observation alone take several times as long to learn.

    Args:
        observation_space: of one player.
        factors: entries of the observation that are multiplied, see :meth:`of`.
        gates: entries of the observation that multiply them.
    """

    def __init__(self, observation_space: spaces.Space[np.ndarray], factors: list[int], gates: list[int]) -> None:
        size = int(np.prod(observation_space.shape or ()))
        super().__init__(observation_space, size + len(factors) * len(gates))
        self.factors, self.gates = list(factors), list(gates)

    @staticmethod
    def of(layout: ObservationLayout) -> dict[str, list[int]]:
        """The arguments for a layout."""

        def entries(*names: str) -> list[int]:
            return [entry for name in names for entry in range(*layout.slices[name].indices(layout.size))]

        return {"factors": entries("own_gradient", "relative_estimates"), "gates": entries("weights", "player")}

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """(R, size) to (R, size + factors × gates), factors outermost."""
        products = observations[:, self.factors, None] * observations[:, None, self.gates]
        return torch.cat([observations, products.flatten(1)], dim=1)
