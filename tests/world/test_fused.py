"""The compiled step and numpy make the same numbers, and nothing but the time depends on numba."""

import copy
import math
import pickle

import numpy as np
import pytest
from extras import need_numba
from processes import run_python
from worlds import FAULTY

from ptne_env import CATALOGUE, VectorParallelEnv, parallel_env
from ptne_env.bench.suite import ptne_v1
from ptne_env.world import fused

WITHOUT_FAULTS = {"message_range": None, "channel": "perfect", "disturbance": None}


def _worlds():
    """Every scenario and track, and every track with faults once more without them, by name."""
    worlds = dict(CATALOGUE)
    for suite in (ptne_v1(),):
        for track in suite.tracks:
            worlds[f"{suite.name} {track.name}"] = track.scenario
            clean = track.scenario.replace(**WITHOUT_FAULTS)
            if clean != track.scenario:
                worlds[f"{suite.name} {track.name} without faults"] = clean
    return worlds


WORLDS = _worlds()

NUMPY_ALONE = {
    "non-quadratic",
    "non-quadratic-switching",
    "non-quadratic-printed",
    "rate-control",
    "ptne-v1 curved without faults",
    *(name.removesuffix(" without faults") for name in WORLDS if name.endswith("faults")),
}
"""The worlds without a compiled step: games that are not affine, and channels and disturbances."""


@pytest.fixture
def compiled(monkeypatch):
    """Steps are compiled from the first on, however large the world."""
    need_numba()
    monkeypatch.setattr(fused, "_spent", math.inf)
    monkeypatch.setattr(fused, "LARGEST_ALONE", math.inf)
    monkeypatch.setattr(fused, "LARGEST_TOGETHER", math.inf)


def vector_env(scenario, num_envs, *, by_numpy=False, **arguments):
    env = VectorParallelEnv(scenario, num_envs, interface="physical", **arguments)
    for block in env._blocks:
        block._fused = None if by_numpy else block._fused
    return env


def one_env(scenario):
    return parallel_env(scenario, interface="physical")


def bits(array):
    return array.dtype, array.shape, np.ascontiguousarray(array).tobytes()


def check_equal(envs, steps, seed=0):
    """Step two environments alike, and compare all that they return and hold; some actions are outside the box."""
    ours, numpys = envs
    generator = np.random.default_rng(seed)
    assert bits(ours.reset(seed=seed)) == bits(numpys.reset(seed=seed))
    for step in range(steps):
        shape = (ours.num_envs, ours.num_players, ours.layout.action_size)
        width = ours.layout.action_bound * (1.2 if step % 3 == 0 else 0.01)
        actions = generator.uniform(-width, width, shape).astype(np.float32)
        outcome, expected = ours.step(actions), numpys.step(actions)
        assert bits(outcome.observations) == bits(expected.observations), step
        np.testing.assert_allclose(outcome.rewards, expected.rewards, rtol=0, atol=1e-12)
        assert bits(outcome.terminated) == bits(expected.terminated)
        for block, other in zip(ours._blocks, numpys._blocks, strict=True):
            for name in ("step", "estimates", "own_gradients", "diverged"):
                assert bits(getattr(block.state, name)) == bits(getattr(other.state, name)), (step, name)
        over = outcome.terminated | (np.arange(ours.num_envs) % 3 == step % 7)
        if over.any():
            assert bits(ours.reset(mask=over)) == bits(numpys.reset(mask=over))


def kernel_calls(monkeypatch):
    """A list that grows with every step that the compiled function makes."""
    kernels, calls = fused.kernels(), []
    step = kernels.step
    monkeypatch.setattr(kernels, "step", lambda *arguments: step(*arguments) and not calls.append(1))
    return calls


@pytest.mark.parametrize("name", WORLDS)
def test_a_world_steps_bit_for_bit_the_same_compiled(name, compiled, monkeypatch):
    calls, num_envs = kernel_calls(monkeypatch), 4
    envs = [vector_env(WORLDS[name], num_envs, by_numpy=flag) for flag in (False, True)]
    steps = 12
    check_equal(envs, steps)
    assert len(calls) == (0 if name in NUMPY_ALONE else steps * len(envs[0]._blocks))


@pytest.mark.parametrize("num_envs", [1, 63, 64, 65, 130])
@pytest.mark.parametrize("name", ["energy", "random-energy-switching", "ev-charging"])
def test_batches_of_any_size_are_the_same_compiled(name, num_envs, compiled):
    envs = [vector_env(WORLDS[name], num_envs, by_numpy=flag) for flag in (False, True)]
    check_equal(envs, 4)


def test_players_with_clocks_of_their_own_and_random_graphs_are_the_same_compiled(compiled, monkeypatch):
    calls, scenario = kernel_calls(monkeypatch), FAULTY.replace(**WITHOUT_FAULTS)
    check_equal([vector_env(scenario, 70, by_numpy=flag) for flag in (False, True)], 20)
    assert len(calls) == 20


def test_episodes_end_at_the_same_step_compiled(compiled, monkeypatch):
    calls, envs = kernel_calls(monkeypatch), [vector_env("energy", 3, by_numpy=flag) for flag in (False, True)]
    for env in envs:
        env.reset(seed=0)
        env.step(np.zeros((3, 5, 5), dtype=np.float32))
        env.reset(mask=[False, True, False])  # ends one step later
    for step in range(1, 1000):
        outcome, expected = (env.step(np.zeros((3, 5, 5), dtype=np.float32)) for env in envs)
        assert bits(outcome.terminated) == bits(expected.terminated), step
        if outcome.terminated.any():
            break
    assert outcome.terminated.tolist() == [True, False, True]
    assert len(calls) == step + 1


@pytest.mark.parametrize("sign", [-1, 1])
def test_environments_that_diverge_are_left_to_numpy(sign, compiled):
    arguments = {"input_limit": 1e9}
    envs = [vector_env("random-energy", 5, by_numpy=flag, **arguments) for flag in (False, True)]
    for env in envs:
        env.reset(seed=0)
    actions = np.zeros((5, 5, 5), dtype=np.float32)
    actions[2] = sign * envs[0].layout.action_bound
    for step in range(3):
        ours, expected = (env.step(actions, restart=np.arange(5) == 2 if step else None) for env in envs)
        assert ours.infos["diverged"].tolist() == expected.infos["diverged"].tolist()
        assert ours.infos["diverged"][2] == (step == 0)
        assert bits(ours.observations) == bits(expected.observations)
        assert bits(ours.rewards) == bits(expected.rewards)


def test_numpy_and_the_compiled_step_may_take_turns_in_an_episode(compiled, monkeypatch):
    mixed, pure = (one_env("random-energy") for _ in range(2))
    pure._simulation._fused = None
    generator, calls = np.random.default_rng(0), kernel_calls(monkeypatch)
    mixed.reset(seed=1), pure.reset(seed=1)
    for step in range(20):
        monkeypatch.setattr(fused, "_spent", math.inf if step % 3 else 0.0)
        actions = {agent: generator.uniform(-0.3, 0.3, 5).astype(np.float32) for agent in mixed.agents}
        (observations, *rest), (expected, *other) = mixed.step(actions), pure.step(actions)
        assert rest == other
        assert all(bits(observations[agent]) == bits(expected[agent]) for agent in expected)
    assert len(calls) == 13


def test_actions_outside_the_box_are_clipped_and_counted_alike_compiled(compiled, monkeypatch):
    calls, (ours, numpys) = kernel_calls(monkeypatch), [one_env("energy") for _ in range(2)]
    numpys._simulation._fused = None
    ours.reset(seed=0), numpys.reset(seed=0)
    for dtype in (np.float32, np.float64):
        actions = {agent: np.zeros(5, dtype=dtype) for agent in ours.agents}
        actions["player_1"][:2] = -3 * ours.layout.action_bound
        actions["player_3"][4] = np.nextafter(ours.layout.action_bound, np.inf, dtype=dtype)
        (observations, *rest), (expected, *other) = ours.step(actions), numpys.step(actions)
        assert rest == other
        assert [info["clipped"] for info in rest[-1].values()] == [0, 2, 0, 1, 0]
        assert all(bits(observations[agent]) == bits(expected[agent]) for agent in expected)
    assert len(calls) >= 2
    before = ours.get_state()
    actions["player_2"][3] = np.nan
    with pytest.raises(ValueError, match="player_2 is not finite"):
        ours.step(actions)
    assert ours.get_state() is before


def random_steps(env, seed, count):
    """Joint actions within the box, and the results of their steps, with the state after each if it is asked for."""
    generator, bound = np.random.default_rng(seed), env.layout.action_bound
    for _ in range(count):
        actions = generator.uniform(-0.02 * bound, 0.02 * bound, (len(env.agents), env.layout.action_size))
        observations, *rest = env.step(dict(zip(env.agents, actions.astype(np.float32), strict=True)))
        yield {agent: bits(row) for agent, row in observations.items()}, rest


def state_bits(state):
    return [bits(array) for array in (state.step, state.estimates, state.own_gradients, state.diverged)]


@pytest.mark.parametrize("pause", [1, 2, 3])
def test_a_state_that_was_handed_out_never_changes_compiled(pause, compiled, monkeypatch):
    calls, (asked, alone) = kernel_calls(monkeypatch), [one_env("energy") for _ in range(2)]
    asked.reset(seed=0), alone.reset(seed=0)
    handed = [(asked.get_state(), state_bits(asked.get_state()))]
    for step, (ours, expected) in enumerate(zip(random_steps(asked, 1, 12), random_steps(alone, 1, 12), strict=True)):
        assert ours == expected
        if step % pause == 0:
            state = asked.get_state()
            assert state is asked.get_state()
            assert state.step.tolist() == [step + 1]
            handed.append((state, state_bits(state)))
    assert [state_bits(state) for state, _ in handed] == [before for _, before in handed]
    assert state_bits(alone.get_state()) == state_bits(asked.get_state())
    assert len(calls) == 24


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])  # noqa: S301 - our own bytes
def test_copies_in_the_middle_of_an_episode_go_on_alone_compiled(duplicate, compiled, monkeypatch):
    calls, env = kernel_calls(monkeypatch), one_env("random-energy")
    env.reset(seed=0)
    list(random_steps(env, 1, 3))
    first, second = duplicate(env), duplicate(env)
    expected = list(random_steps(env, 2, 5))
    assert list(random_steps(first, 2, 5)) == expected
    assert list(random_steps(second, 2, 5)) == expected
    assert state_bits(first.get_state()) == state_bits(env.get_state())
    assert len(calls) == 18


# --- the switch -------------------------------------------------------------------------------------------------------

PLAY = """
import warnings, sys
warnings.simplefilter("error")
import numpy as np, ptne_env
from ptne_env.world import fused
env = ptne_env.parallel_env("energy", interface="physical")
def play(steps):
    env.reset(seed=0)
    for _ in range(steps):
        env.step({agent: np.zeros(5, dtype=np.float32) for agent in env.agents})
"""


def test_numba_is_imported_when_steps_have_taken_long_enough_and_silently():
    need_numba()
    program = f"{PLAY}\nplay(3)\nprint('numba' in sys.modules)\nfused._spent = fused.PATIENCE\nplay(3)\n"
    run = run_python("-c", f"{program}print('numba' in sys.modules, fused.kernels() is not None)")
    assert (run.stdout.split(), run.stderr) == (["False", "True", "True"], "")


def test_a_broken_numba_is_one_warning_and_the_numpy_path(tmp_path):
    (tmp_path / "numba").mkdir()
    (tmp_path / "numba" / "__init__.py").write_text("raise SystemError('no LLVM')", encoding="utf-8")
    program = f"""
sys.path.insert(0, {str(tmp_path)!r})
fused._spent = fused.PATIENCE
warnings.simplefilter("always")
with warnings.catch_warnings(record=True) as caught:
    play(5)
print(*[f"{{type(each.message).__name__}}: {{each.message}}" for each in caught], sep="\\n")
"""
    lines = run_python("-c", PLAY + program).stdout.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("RuntimeWarning: the compiled step is left out, and numpy makes all steps, because")


@pytest.mark.parametrize("why", ["numba is not installed", "its compiler is switched off"])
def test_without_numba_numpy_makes_all_steps_silently(why, tmp_path):
    program = "sys.modules['numba'] = None\n"
    if why != "numba is not installed":
        need_numba()
        program = "import os\nos.environ['NUMBA_DISABLE_JIT'] = '1'\n"
    run = run_python("-c", f"{PLAY}{program}fused._spent = fused.PATIENCE\nplay(5)\nprint(fused.kernels())")
    assert (run.stdout.strip(), run.stderr) == ("None", "")


def test_a_processor_that_rounds_differently_is_one_warning_and_the_numpy_path(compiled, monkeypatch):
    kernels = fused.kernels()
    step = kernels.step

    def inexact(actions, *arguments):
        in_range = step(actions, *arguments)
        arguments[4][0, 0, 0] = np.nextafter(arguments[4][0, 0, 0], 1)  # the next estimates
        return in_range

    monkeypatch.setattr(kernels, "step", inexact)
    ours, expected = vector_env("energy", 3), vector_env("energy", 3, by_numpy=True)
    ours.reset(seed=0), expected.reset(seed=0)
    actions = np.zeros((3, 5, 5), dtype=np.float32)
    with pytest.warns(RuntimeWarning, match="its numbers are not those of numpy") as caught:
        results = [ours.step(actions) for _ in range(3)]
    assert len(caught) == 1
    assert [bits(result.observations) for result in results] == [
        bits(expected.step(actions).observations) for _ in range(3)
    ]
