"""TorchRL: PPO on tensordicts, with the players stacked in the group "player" and one network for all of them.

Two environments with the same keys: ``PettingZooWrapper``, one at a time, and ``TorchRLEnv``, stepped together.

Run it with: python examples/ecosystem/torchrl_ppo.py
"""

import numpy as np
import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule
from tensordicts import ACTION, OBSERVATION, law_digits
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import EnvBase, PettingZooWrapper, check_env_specs
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from yardstick import EPISODES, LAW, SCENARIO, digits, policy_of, report

import ptne_env
from ptne_env.envs.torchrl import TorchRLEnv


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Two layers of 64, applied to the last axis; players, environments and time are batch dimensions."""
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))


def train(env: EnvBase) -> tuple[float, float]:
    """Return the digits before and after a short training."""
    torch.manual_seed(0)
    check_env_specs(env)
    size, actions = env.layout.size, env.layout.action_size
    mean = nn.Sequential(network(size, 2 * actions), NormalParamExtractor(scale_mapping="biased_softplus_0.4"))
    actor = ProbabilisticActor(
        TensorDictModule(mean, [OBSERVATION], [("player", "loc"), ("player", "scale")]),
        spec=env.full_action_spec_unbatched,
        in_keys=[("player", "loc"), ("player", "scale")],
        out_keys=[ACTION],
        distribution_class=TanhNormal,
        return_log_prob=True,
        log_prob_key=("player", "sample_log_prob"),
    )
    critic = ValueOperator(network(size, 1), in_keys=[OBSERVATION], out_keys=[("player", "state_value")])
    loss = ClipPPOLoss(actor, critic, normalize_advantage=True, entropy_coeff=0.0)
    loss.set_keys(
        action=ACTION, sample_log_prob=("player", "sample_log_prob"), value=("player", "state_value"),
        reward=("player", "reward"), done=("player", "done"), terminated=("player", "terminated"),
    )  # fmt: skip
    loss.make_value_estimator(gamma=0.9, lmbda=0.9)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)

    @torch.no_grad()
    def act(observations: np.ndarray) -> np.ndarray:
        return torch.tanh(mean(torch.from_numpy(observations))[0]).numpy()

    before = digits(policy_of(act))
    for batch in Collector(env, actor, frames_per_batch=800, total_frames=6400):
        for _ in range(5):
            with torch.no_grad():
                loss.value_estimator(batch)
            frames = batch.reshape(-1)
            for rows in torch.randperm(len(frames)).split(100):
                losses = loss(frames[rows])
                optimiser.zero_grad()
                (losses["loss_objective"] + losses["loss_critic"]).backward()
                optimiser.step()
    return before, digits(policy_of(act))


def one_at_a_time(**arguments: str) -> EnvBase:
    """One environment, whose dictionaries become a tensordict."""
    return PettingZooWrapper(ptne_env.parallel_env(SCENARIO, **arguments), seed=0)


def main() -> None:
    """TorchRL's own check, the law's digits and a short training, of each of the two."""
    report(law_digits(one_at_a_time(**LAW)), *train(one_at_a_time()), "one at a time")
    report(
        law_digits(TorchRLEnv(SCENARIO, EPISODES, **LAW)), *train(TorchRLEnv(SCENARIO, 8, seed=0)), "stepped together"
    )


if __name__ == "__main__":
    main()
