"""Random worlds under random use, each in a few episodes; tests/soak.py plays a hundred thousand."""

import random

import numpy as np
import pytest
from fuzz import a_world, session
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from soak import attempt, main

from ptne_env import VectorParallelEnv
from ptne_env.perception.encoder import Encoder
from ptne_env.world import dynamics


@settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(st.randoms(use_true_random=False))
def test_all_assertions_hold_in_random_sessions(rng):
    session(rng, 10)


@pytest.mark.filterwarnings("ignore:.*short of the deadline")
def test_random_worlds_cover_every_kind_of_part():
    scenarios = []
    for seed in range(120):
        try:
            scenarios.append(a_world(random.Random(seed))[0])  # noqa: S311 - worlds, not secrets
        except ValueError:
            continue
    assert len(scenarios) > 60
    for field in ("game", "topology"):
        assert len({getattr(scenario, field).target for scenario in scenarios}) >= 4
    stages = {stage.target for scenario in scenarios for _, stages in scenario.channel.arguments for stage in stages}
    assert len(stages) == 6
    for field in ("disturbance", "transformation", "slots"):
        assert len({getattr(scenario, field) for scenario in scenarios}) >= 2
    assert any(scenario.hold_steps for scenario in scenarios)


def clip_nan(encoder, actions):
    bound = encoder.layout.action_bound
    return np.clip(actions, -bound, bound), np.zeros(actions.shape[:2], dtype=int)


def share_observations(env, buffers={}):  # noqa: B006 - sharing is the fault
    shape = (env.num_envs, env.num_players, env.layout.size)
    return buffers.setdefault(shape, np.empty(shape, dtype=np.float32))


IS_OVER = dynamics.is_over
FAULTS = {
    "NaN is accepted": (Encoder, "clip", clip_nan),
    "observations are overwritten": (VectorParallelEnv, "_new_observations", share_observations),
    "episodes end late": (dynamics, "is_over", lambda world, state: IS_OVER(world, state) & (state.step % 2 == 0)),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_random_sessions_find_the_fault(fault, monkeypatch):
    owner, name, broken = FAULTS[fault]
    monkeypatch.setattr(owner, name, broken)
    assert any(attempt(seed, 10)[1] for seed in range(40))


def test_a_soak_prints_violations_with_their_world_and_fails(monkeypatch, capsys):
    monkeypatch.setattr(Encoder, "clip", clip_nan)
    monkeypatch.setattr("soak.CHUNK", 8)
    assert main(["--episodes", "1000", "--each", "5", "--jobs", "1"]) == 1
    assert ": Traceback" in capsys.readouterr().out
