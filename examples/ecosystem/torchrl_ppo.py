"""TorchRL: PPO on tensordicts, with the players stacked in the group "player" and one network for all of them.

Run it with: python examples/ecosystem/torchrl_ppo.py
"""

import numpy as np
import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import PettingZooWrapper, check_env_specs
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from yardstick import EPISODES, SCENARIO, TASK, Acting, digits, law, report

import ptne_env

OBSERVATION, ACTION = ("player", "observation"), ("player", "action")


def law_digits() -> list[float]:
    """The digits that the law gains through the wrapper; each episode starts with ``reset(seed=...)``."""
    env = PettingZooWrapper(ptne_env.parallel_env(SCENARIO))
    policy = law(env.layout)
    act = TensorDictModule(lambda o: torch.from_numpy(policy.predict(o.numpy())[0]), [OBSERVATION], [ACTION])
    gained = []
    for seed in range(EPISODES):
        episode = env.rollout(10_000, act, auto_reset=False, tensordict=env.reset(seed=seed))
        gained.append(episode["next", "player", "reward"].double().sum(dim=0).mean().item())
    return gained


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Two layers of 64, applied to the last axis; players and time are batch dimensions."""
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))


def main() -> None:
    """TorchRL's own check, the law's digits, and a short training."""
    torch.manual_seed(0)
    env = PettingZooWrapper(ptne_env.parallel_env(SCENARIO, **TASK), seed=0)
    check_env_specs(env)
    size, actions = env.layout.size, env.layout.action_size
    mean = nn.Sequential(network(size, 2 * actions), NormalParamExtractor(scale_mapping="biased_softplus_0.4"))
    actor = ProbabilisticActor(
        TensorDictModule(mean, [OBSERVATION], [("player", "loc"), ("player", "scale")]),
        spec=env.full_action_spec,
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

    before = digits(Acting(act))
    for batch in Collector(env, actor, frames_per_batch=800, total_frames=6400):
        for _ in range(5):
            with torch.no_grad():
                loss.value_estimator(batch)
            for rows in torch.randperm(len(batch)).split(100):
                losses = loss(batch[rows])
                optimiser.zero_grad()
                (losses["loss_objective"] + losses["loss_critic"]).backward()
                optimiser.step()
    report(law_digits(), before, digits(Acting(act)))


if __name__ == "__main__":
    main()
