"""CleanRL's style: PPO in one file that reads top to bottom, on many environments of many players at once.

The players of all environments are rows of one batch, and one network acts for all of them.

Run it with: python examples/ecosystem/cleanrl_ppo.py --total-steps 64000
"""

import argparse
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import nn
from torch.distributions import Normal
from yardstick import EPISODES, LAW, SCENARIO, digits, law, policy_of, report

from ptne_env import VectorParallelEnv


@dataclass
class Args:
    """The options of the command line."""

    seed: int = 0
    """seed of the network, the sampling and the games"""
    total_steps: int = 32_000
    """steps of training, counting every player of every environment"""
    num_envs: int = 16
    """number of environments that are stepped together"""
    num_steps: int = 50
    """steps of every environment between updates"""
    epochs: int = 5
    """number of passes over the steps between updates"""
    minibatch: int = 500
    """number of rows of a gradient step"""
    learning_rate: float = 1e-3
    """learning rate of Adam"""
    gamma: float = 0.9
    """discount factor"""
    gae_lambda: float = 0.9
    """λ of generalised advantage estimation"""
    clip: float = 0.2
    """largest change of the probability ratio"""
    max_grad_norm: float = 0.5
    """largest norm of a gradient step"""


def parse() -> Args:
    """Return the arguments from the command line."""
    parser = argparse.ArgumentParser(description="PPO in one file.")
    for field in fields(Args):
        parser.add_argument(f"--{field.name.replace('_', '-')}", type=type(field.default), default=field.default)
    return Args(**vars(parser.parse_args()))


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Return a network with two tanh layers of 64 units."""
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))


def law_digits() -> np.ndarray:
    """Return the digits that the law gains in the same loop."""
    env = VectorParallelEnv(SCENARIO, EPISODES, **LAW)
    policy, (observations, _) = law(env.layout), env.reset(seed=0)
    gained, over = np.zeros(EPISODES), np.zeros(EPISODES, dtype=bool)
    while not over.any():  # the episodes of a scenario end together unless one diverges
        actions, _ = policy.predict(observations.reshape(-1, env.layout.size))
        observations, rewards, terminated, truncated, _ = env.step(actions.reshape(EPISODES, env.num_players, -1))
        gained, over = gained + rewards.mean(axis=1), terminated | truncated
    return gained


def main() -> None:
    """Print the law's digits and those of a short training."""
    args = parse()
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    env = VectorParallelEnv(SCENARIO, args.num_envs)
    rows = args.num_envs * env.num_players
    size, action_size = env.layout.size, env.layout.action_size
    actor, critic = network(size, action_size), network(size, 1)
    log_std = nn.Parameter(torch.full((action_size,), -1.0))
    parameters = [*actor.parameters(), *critic.parameters(), log_std]
    optimiser = torch.optim.Adam(parameters, lr=args.learning_rate, eps=1e-5)

    @torch.no_grad()
    def act(observations: np.ndarray) -> np.ndarray:
        return actor(torch.from_numpy(observations)).clamp(-1, 1).numpy()

    before = digits(policy_of(act))

    shape = (args.num_steps, rows)
    states, actions = torch.zeros(*shape, size), torch.zeros(*shape, action_size)
    logprobs, rewards, ends, values = (torch.zeros(shape) for _ in range(4))
    state = torch.from_numpy(env.reset(seed=args.seed)[0]).reshape(rows, size)
    for _ in range(args.total_steps // (args.num_steps * rows)):
        with torch.no_grad():
            for step in range(args.num_steps):
                states[step], values[step] = state, critic(state).squeeze(-1)
                distribution = Normal(actor(state), log_std.exp())
                actions[step] = distribution.sample()
                logprobs[step] = distribution.log_prob(actions[step]).sum(-1)
                chosen = actions[step].clamp(-1, 1).reshape(args.num_envs, env.num_players, action_size)
                observations, reward, terminated, truncated, _ = env.step(chosen.numpy())
                # No episode is truncated here. If one were, add gamma · critic(last observation) to its reward.
                over = terminated | truncated
                rewards[step] = torch.from_numpy(reward).reshape(rows)
                ends[step] = torch.from_numpy(over.repeat(env.num_players)).float()
                if over.any():
                    observations, _ = env.reset(mask=over)
                state = torch.from_numpy(observations).reshape(rows, size)

            advantages, following, trace = torch.zeros(shape), critic(state).squeeze(-1), torch.zeros(rows)
            for step in reversed(range(args.num_steps)):
                continues = 1 - ends[step]
                delta = rewards[step] + args.gamma * continues * following - values[step]
                advantages[step] = trace = delta + args.gamma * args.gae_lambda * continues * trace
                following = values[step]

        batch = [part.flatten(0, 1) for part in (states, actions, logprobs, advantages, advantages + values)]
        for _ in range(args.epochs):
            for chosen_rows in torch.randperm(args.num_steps * rows).split(args.minibatch):
                seen, taken, logprob, advantage, returns = (part[chosen_rows] for part in batch)
                ratio = (Normal(actor(seen), log_std.exp()).log_prob(taken).sum(-1) - logprob).exp()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                clipped = ratio.clamp(1 - args.clip, 1 + args.clip)
                policy_loss = -torch.min(advantage * ratio, advantage * clipped).mean()
                value_loss = 0.5 * (critic(seen).squeeze(-1) - returns).square().mean()
                optimiser.zero_grad()
                (policy_loss + value_loss).backward()
                nn.utils.clip_grad_norm_(parameters, args.max_grad_norm)
                optimiser.step()

    report(law_digits(), before, digits(policy_of(act)))


if __name__ == "__main__":
    main()
