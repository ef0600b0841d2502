"""Every adapter steps the same world: bit for bit, step by step, through resets."""

from types import SimpleNamespace

import numpy as np
import pytest
from worlds import BLOCKS_SWITCHING, FAULTY, channel_part, large_energy_scenario, make_env

from ptne_env import VectorParallelEnv, get_scenario
from ptne_env.envs import vector as vector_module
from ptne_env.envs.gymnasium import JointEnv, JointVectorEnv
from ptne_env.world.rewards import TERMS
from ptne_env.world.world import World

try:
    from ptne_env.envs.sb3 import PlayerVecEnv
except ImportError:  # without the extra 'sb3' the others agree all the same; test_sb3.py tells that it was left out
    PlayerVecEnv = None

BATCH, STEPS, SEED = 5, 27, 11
CRASHING = 1
"""The environment in the middle of the batch that leaves the range in the scenario ``crashing``."""

WORLDS = {
    "fixed": ("energy", {"start": "random", "steps": 7}),
    "switching": ("energy-switching", {"start": "random", "spacing": "physical", "steps": 13}),
    "cut": (
        "energy-switching-transformed",
        {"start": "random", "spacing": "transformed", "steps": 40, "max_cycles": 9},
    ),
    "random games": ("random-energy", {"steps": 5, "hold_steps": 3}),
    "random games, switching": ("random-energy-switching", {"spacing": "physical", "steps": 13, "max_cycles": 11}),
    "non-quadratic": ("non-quadratic-switching", {"start": "random", "spacing": "physical", "steps": 13}),
    "blocks": (BLOCKS_SWITCHING, {"spacing": "transformed", "steps": 30, "max_cycles": 8}),
    "large": (large_energy_scenario(), {"steps": 6}),
    "faulty": (FAULTY, {"max_cycles": 8}),
    "one player lies": (
        FAULTY.replace(
            channel=channel_part(
                "Chain", stages=[channel_part("Lying", size=3.0), channel_part("OneWayLinks", share=0.7)]
            )
        ),
        {"max_cycles": 8},
    ),
    "crashing": ("random-energy", {"max_cycles": 14, "input_limit": 1e9, "action_scale": 1e9}),
}
REWARDS = [*TERMS, {"digits": 1.0, "payoff": 1e-3, "tracking": 0.5}]
CASES = [
    pytest.param(world, reward, id=f"{world}-{reward if isinstance(reward, str) else 'mixture'}")
    for world in WORLDS
    for reward in REWARDS
    if world != "non-quadratic" or reward != "regret"  # which does not exist there
]


def scripted_actions(env, world, mode):
    """Actions for every step and environment, some outside the box; shape (STEPS, B, N, action size)."""
    bound = env.layout.action_bound
    shape = (STEPS, BATCH, env.layout.num_players, env.layout.action_size)
    unit = np.random.default_rng(0).uniform(-1.2, 1.2, shape)
    if world == "crashing":
        unit *= 0.1 if mode == "gains" else 1e-9
        unit[:: 1 if mode == "gains" else 5, CRASHING] = 1.0
    return (bound * unit).astype(np.float32)


def observed(observations):
    return np.stack(list(observations.values()))


def play_alone(env, seed, actions):
    """An environment of its own: its first observation, and a record of each step, with a reset after each end."""
    observations, _ = env.reset(seed=seed)
    first, steps = observed(observations), []
    for rows in actions:
        agents = env.agents
        observations, rewards, terminations, truncations, infos = env.step(dict(zip(agents, rows, strict=True)))
        step = SimpleNamespace(
            observations=observed(observations),
            rewards=np.array(list(rewards.values())),
            terminated=terminations[agents[0]],
            truncated=truncations[agents[0]],
            diverged=infos[agents[0]]["diverged"],
            clipped=np.array([infos[agent]["clipped"] for agent in agents]),
            terms={
                name: np.array([infos[agent][name] for agent in agents])
                for name in infos[agents[0]]
                if name.startswith("reward_")
            },
            success=infos[agents[0]]["is_success"],
        )
        step.over = not env.agents
        step.following = observed(env.reset()[0]) if step.over else step.observations
        steps.append(step)
    return first, steps


def together(records):
    """The records of the environments, stacked: environments first."""
    firsts, columns = zip(*records, strict=True)
    steps = []
    for row in zip(*columns, strict=True):
        names = [name for name in vars(row[0]) if name != "terms"]
        step = SimpleNamespace(**{name: np.stack([getattr(each, name) for each in row]) for name in names})
        step.terms = {name: np.stack([each.terms[name] for each in row]) for name in row[0].terms}
        steps.append(step)
    return np.stack(firsts), steps


def mean_over_players(values):
    """Over the second axis, player after player."""
    total = values[:, 0].copy()
    for player in range(1, values.shape[1]):
        total += values[:, player]
    return total / values.shape[1]


def equal(found, expected):
    assert found.dtype == expected.dtype
    np.testing.assert_array_equal(found, expected, strict=True)


def check_vector(env, first, steps, actions):
    equal(env.reset(seed=SEED), first)
    for step, rows in zip(steps, actions, strict=True):
        outcome = env.step(rows)
        equal(outcome.observations, step.observations)
        equal(outcome.rewards, step.rewards)
        equal(outcome.terminated, step.terminated)
        equal(outcome.truncated, step.truncated)
        equal(outcome.infos["diverged"], step.diverged)
        equal(outcome.infos["clipped"], step.clipped)
        equal(outcome.infos["is_success"], step.success)
        assert env.reward_names == list(step.terms)
        for name, term in step.terms.items():
            equal(outcome.infos[name], term)
        if step.over.any():
            equal(env.reset(mask=step.over), step.following)


def check_joint(env, index, first, steps, actions):
    observation, info = env.reset(seed=SEED + index)
    equal(observation, first[index].reshape(-1))
    kinds = {name: value.dtype for name, value in info.items()}
    for step, rows in zip(steps, actions, strict=True):
        observation, reward, terminated, truncated, info = env.step(rows[index].reshape(-1))
        equal(observation, step.observations[index].reshape(-1))
        assert reward == mean_over_players(step.rewards)[index]
        assert (terminated, truncated) == (step.terminated[index], step.truncated[index])
        assert info["diverged"] == step.diverged[index]
        assert info["clipped"] == step.clipped[index].sum()
        assert {name: info[name] for name in step.terms} == {
            name: mean_over_players(term)[index] for name, term in step.terms.items()
        }
        assert info["is_success"] == step.success[index]
        assert {name: value.dtype for name, value in info.items()} == kinds
        if step.over[index]:
            equal(env.reset()[0], step.following[index].reshape(-1))


def check_joint_vector(env, first, steps, actions):
    observations, infos = env.reset(seed=SEED)
    equal(observations, first.reshape(BATCH, -1))
    assert all(infos[f"_{name}"].all() for name in infos if not name.startswith("_"))
    for step, rows in zip(steps, actions, strict=True):
        observations, rewards, terminated, truncated, infos = env.step(rows.reshape(BATCH, -1))
        equal(observations, step.following.reshape(BATCH, -1))
        equal(rewards, mean_over_players(step.rewards))
        equal(terminated, step.terminated)
        equal(truncated, step.truncated)
        assert ("final_obs" in infos) == step.over.any()
        for index in np.flatnonzero(step.over):
            equal(infos["final_obs"][index], step.observations[index].reshape(-1))
            final = infos["final_info"]
            assert final["is_success"][index] == step.success[index]
            assert final["diverged"][index] == step.diverged[index]
            assert final["clipped"][index] == step.clipped[index].sum()
            for name, term in step.terms.items():
                assert final[name][index] == mean_over_players(term)[index]


def check_slots(env, first, steps, actions):
    slots = BATCH * first.shape[1]
    env.seed(SEED)
    equal(env.reset(), first.reshape(slots, -1))
    for step, rows in zip(steps, actions, strict=True):
        observations, rewards, dones, infos = env.step(rows.reshape(slots, -1))
        equal(observations, step.following.reshape(slots, -1))
        equal(rewards, step.rewards.reshape(slots).astype(np.float32))
        equal(dones, np.repeat(step.over, slots // BATCH))
        for slot, info in enumerate(infos):
            index, player = divmod(slot, slots // BATCH)
            if not dones[slot]:
                assert info == {}
                continue
            equal(info.pop("terminal_observation"), step.observations[index, player])
            assert info.pop("episode")["l"] > 0
            assert info == {
                "TimeLimit.truncated": step.truncated[index],
                "diverged": step.diverged[index],
                "clipped": step.clipped[index, player],
                "is_success": step.success[index],
                **{name: term[index, player] for name, term in step.terms.items()},
            }


@pytest.mark.parametrize("mode", ["input", "gains"])
@pytest.mark.parametrize("interface", ["physical", "scaled"])
@pytest.mark.parametrize(("world", "reward"), CASES)
def test_all_adapters_agree_bit_for_bit_step_by_step_through_resets(world, reward, interface, mode, monkeypatch):
    scenario, fields = WORLDS[world]
    arguments = {"input_limit": 5.0, **fields, "reward": reward, "interface": interface, "action_mode": mode}
    envs = [make_env(scenario, **arguments) for _ in range(BATCH)]
    actions = scripted_actions(envs[0], world, mode)
    first, steps = together([play_alone(env, SEED + index, actions[:, index]) for index, env in enumerate(envs)])

    check_vector(VectorParallelEnv(scenario, BATCH, **arguments), first, steps, actions)
    check_joint_vector(JointVectorEnv(scenario, BATCH, autoreset_mode="SameStep", **arguments), first, steps, actions)
    if PlayerVecEnv is not None:
        check_slots(PlayerVecEnv(scenario, BATCH, **arguments), first, steps, actions)
    for index in (0, CRASHING):
        check_joint(JointEnv(scenario, **arguments), index, first, steps, actions)
    monkeypatch.setattr(vector_module, "BLOCK_SIZE", 2)
    in_blocks = VectorParallelEnv(scenario, BATCH, **arguments)
    assert len(in_blocks._blocks) == 3
    check_vector(in_blocks, first, steps, actions)

    # What the comparison has seen: every way to end, and environments that end while others go on.
    ends = sum(step.over.sum() for step in steps)
    assert ends >= BATCH
    if "max_cycles" in arguments and world != "crashing":
        assert any(step.truncated.any() for step in steps)
    diverged = np.stack([step.diverged for step in steps])
    if world == "crashing":
        assert diverged[:, CRASHING].sum() > 1
        assert not np.delete(diverged, CRASHING, axis=1).any()
        assert any(step.over[CRASHING] and not step.over.all() for step in steps)
        assert any(step.truncated.any() for step in steps)
    elif world not in ("non-quadratic", "cut"):
        assert not diverged.any()
        assert any(step.clipped.any() for step in steps)


def test_compared_scenarios_match_their_names():
    built = {
        name: get_scenario(scenario, **{k: v for k, v in fields.items() if k not in ("max_cycles", "action_scale")})
        for name, (scenario, fields) in WORLDS.items()
    }
    assert {name for name, scenario in built.items() if World(scenario).has_random_game} == {
        "random games",
        "random games, switching",
        "crashing",
        "faulty",
        "one player lies",
    }
    assert {name for name, scenario in built.items() if not World(scenario).topology.is_fixed} == {
        "switching",
        "cut",
        "random games, switching",
        "non-quadratic",
        "blocks",
        "faulty",
        "one player lies",
    }
