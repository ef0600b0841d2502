"""sb3-contrib: recurrent PPO, whose memory passes through ``predict`` like a law's.

Run it with: python examples/ecosystem/sb3_recurrent_ppo.py
or, as a witness of ``ptne train TRACK --algorithm ippo-rnn --steps STEPS``, whose settings it then has, with:
python examples/ecosystem/sb3_recurrent_ppo.py TRACK STEPS
"""

import sys

import numpy as np
from sb3_contrib import RecurrentPPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.utils import LinearSchedule
from yardstick import EPISODES, LAW, SCENARIO, digits, law, report

from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.training.configuration import Configuration
from ptne_env.world.catalogue import get_scenario
from ptne_env.world.world import World


def train_like(configuration: Configuration) -> RecurrentPPO:
    """Return a model after a training with the settings of ``ptne train``."""
    players = World(get_scenario(configuration.scenario)).game.num_players
    env = PlayerVecEnv(configuration.scenario, configuration.environments(players), seed=configuration.seed)
    model = RecurrentPPO(
        "MlpLstmPolicy",
        env,
        n_steps=configuration.rollout,
        batch_size=configuration.rollout * env.num_envs // configuration.minibatches,
        n_epochs=configuration.epochs,
        learning_rate=LinearSchedule(configuration.learning_rate, 0.0, 1.0),
        gamma=configuration.discount,
        gae_lambda=0.9,
        policy_kwargs={
            "log_std_init": configuration.log_std,
            "net_arch": [configuration.hidden[0]],
            "lstm_hidden_size": configuration.hidden[1],
        },
        seed=configuration.seed,
        device="cpu",
    )
    return model.learn(configuration.steps)


def main() -> None:
    """The law's digits by Stable-Baselines3's evaluation, and a short training of an LSTM."""
    evaluation_env = PlayerVecEnv(SCENARIO, EPISODES, seed=0, **LAW)
    returns, _ = evaluate_policy(
        law(evaluation_env.layout),
        evaluation_env,
        n_eval_episodes=evaluation_env.num_envs,
        return_episode_rewards=True,
        warn=False,
    )
    gained = np.reshape(returns, (EPISODES, evaluation_env.layout.num_players)).mean(axis=1)

    env = PlayerVecEnv(SCENARIO, num_envs=16, seed=0)
    model = RecurrentPPO(
        "MlpLstmPolicy", env, n_steps=50, batch_size=500, n_epochs=5, learning_rate=1e-3, gamma=0.9, gae_lambda=0.9,
        policy_kwargs={"log_std_init": -1.0, "lstm_hidden_size": 32}, seed=0, device="cpu",
    )  # fmt: skip
    before = digits(model)
    model.learn(12_000)
    report(gained, before, digits(model))


if __name__ == "__main__":
    if sys.argv[1:]:
        track, steps = sys.argv[1:]
        model = train_like(Configuration(track, "ippo-rnn", steps=int(steps)))
        print(f"{digits(model, scenario=track, episodes=200):.2f} validation digits")
    else:
        main()
