"""PyTorch Geometric: PPO of Stable-Baselines3 on padded graphs, with a graph network as features extractor.

Run it with: python examples/ecosystem/pyg_ppo.py
"""

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch_geometric.nn import MessagePassing, TransformerConv
from yardstick import EPISODES, SCENARIO, Acting, digits, report

from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.perception.observation_forms import make_form


def graph(observation: dict[str, torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The graphs of R players as one: nodes (R, M, F), and links (2, messages) and edges (messages, n + 1) of it."""
    nodes, arrived = observation["nodes"], observation["edge_mask"].bool()
    links = observation["edge_links"].long() + nodes.shape[1] * torch.arange(len(nodes))[:, None, None]
    return nodes, links[arrived].T, observation["edges"][arrived]


class Law(MessagePassing):
    """The paper's static law, which is one round of message passing: u = κ Σ_j a_ij (x^j − x^i) − gradient."""

    def __init__(self) -> None:
        super().__init__(aggr="add")

    def message(self, edge_attr: torch.Tensor) -> torch.Tensor:
        """κ a_ij (x^j − x^i), shape (messages, n)."""
        return 2.0 * edge_attr[:, -1:] * edge_attr[:, :-1]

    def predict(self, observation: dict[str, np.ndarray], *state: object, **_: object) -> tuple[np.ndarray, object]:
        """The inputs of R players, shape (R, n), as Stable-Baselines3's ``predict``."""
        nodes, links, edges = graph({name: torch.as_tensor(part) for name, part in observation.items()})
        inputs = self.propagate(links, edge_attr=edges, size=(nodes.shape[0] * nodes.shape[1],) * 2)
        own = inputs.reshape(*nodes.shape[:2], -1)[:, 0]
        gradient, player = nodes[:, 0, :1], nodes[:, 0, -own.shape[1] :]  # every player has one component
        return (own - gradient * player).numpy(), state


class Messages(BaseFeaturesExtractor):
    """One round of message passing: features of a player from its own node and the messages that arrived."""

    def __init__(self, observation_space: spaces.Dict, features_dim: int = 64) -> None:
        super().__init__(observation_space, features_dim)
        node_size, edge_size = (observation_space[name].shape[1] for name in ("nodes", "edges"))
        self.receive = TransformerConv(node_size, features_dim, edge_dim=edge_size)

    def forward(self, observation: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features of R players, shape (R, features_dim)."""
        nodes, links, edges = graph(observation)
        received = self.receive(nodes.flatten(0, 1), links, edges)
        return torch.tanh(received.reshape(*nodes.shape[:2], -1)[:, 0])


def train() -> tuple[float, float]:
    """Digits before and after a short training; in the comparison the form makes graphs of flat observations."""
    env = PlayerVecEnv(SCENARIO, num_envs=16, seed=0, observation="padded-graph")
    model = PPO(
        "MultiInputPolicy", env, n_steps=50, batch_size=500, n_epochs=5, learning_rate=1e-3, gamma=0.9, gae_lambda=0.9,
        policy_kwargs={"features_extractor_class": Messages, "log_std_init": -1.0}, seed=0, device="cpu",
    )  # fmt: skip
    form = make_form("padded-graph", env.layout)
    policy = Acting(lambda rows: model.predict(form.show(rows), deterministic=True)[0])
    before = digits(policy)
    model.learn(80_000)
    return before, digits(policy)


def main() -> None:
    """The law's digits, as message passing on the graph of each player, and a short training."""
    env = PlayerVecEnv(SCENARIO, EPISODES, seed=0, interface="physical", observation="padded-graph")
    returns, _ = evaluate_policy(Law(), env, n_eval_episodes=env.num_envs, return_episode_rewards=True, warn=False)
    report(np.reshape(returns, (EPISODES, env.layout.num_players)).mean(axis=1), *train())


if __name__ == "__main__":
    main()
