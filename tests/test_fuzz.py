"""Random worlds under random use, each in a few episodes; tests/soak.py plays a hundred thousand."""

import numpy as np
import pytest
from fuzz import KINDS, UNPLAYABLE, play
from soak import attempt, main

from ptne_env import VectorParallelEnv
from ptne_env.perception.encoder import Encoder
from ptne_env.shared.parts import PARTS
from ptne_env.world import dynamics


@pytest.mark.parametrize("name", [name for name in PARTS if name not in UNPLAYABLE])
def test_random_sessions_play_every_part_of_the_library(name):
    kind, _, part = name.partition(":")
    tallies = (play(f"{name} {number}", 1, **{kind: part}) for number in range(30))
    assert any(name in tally.parts for tally in tallies)


@pytest.mark.parametrize("seed", range(10))
def test_random_sessions_find_no_violation(seed):
    """The first worlds of a soak, which plays more of them."""
    play(seed, 10)


def test_the_parts_that_sessions_give_arguments_exist():
    assert {f"{kind}:{name}" for kind, arguments in KINDS.items() for name in arguments} <= set(PARTS)


def test_an_argument_that_a_part_does_not_have_is_a_violation(monkeypatch):
    monkeypatch.setitem(KINDS["game"], "cournot", lambda *_: {"limit": 1.0})
    assert any("part 'game:cournot' has no argument 'limit'" in attempt(seed, 1)[1] for seed in range(40))


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
