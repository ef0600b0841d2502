"""PyTorch Geometric: PPO of Stable-Baselines3 on padded graphs, with a graph network as features extractor.

Run it with: python examples/ecosystem/pyg_ppo.py
"""

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch_geometric.nn import GINEConv
from yardstick import EPISODES, SCENARIO, TASK, Acting, digits, law, report

from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.observation_forms import make_form


class Messages(BaseFeaturesExtractor):
    """One round of message passing: features of a player from its own node and the messages that arrived."""

    def __init__(self, observation_space: spaces.Dict, features_dim: int = 64) -> None:
        super().__init__(observation_space, features_dim)
        node_size, edge_size = (observation_space[name].shape[1] for name in ("nodes", "edges"))
        self.encode = torch.nn.Linear(node_size, features_dim)
        inner = torch.nn.Sequential(torch.nn.Linear(features_dim, features_dim), torch.nn.Tanh())
        self.receive = GINEConv(inner, edge_dim=edge_size)

    def forward(self, observation: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features of R players, shape (R, features_dim); their graphs are parts of one large graph."""
        nodes = self.encode(observation["nodes"])
        rows, count, size = nodes.shape
        links = observation["edge_links"].long() + count * torch.arange(rows)[:, None, None]
        arrived = observation["edge_mask"].bool()
        received = self.receive(nodes.reshape(-1, size), links[arrived].T, observation["edges"][arrived])
        return received.reshape(rows, count, size)[:, 0]


def main() -> None:
    """The law's digits beside padded graphs, and a short training on them."""
    env = PlayerVecEnv(SCENARIO, EPISODES, seed=0, observation="padded-graph")
    flat = PlayerVecEnv(SCENARIO, EPISODES, seed=0)
    policy, players = law(env.layout), env.layout.num_players
    returns = np.zeros(env.num_envs)


if __name__ == "__main__":
    main()
