"""The observer of pushes: the mean velocity of residuals since they last changed."""

from types import SimpleNamespace

import numpy as np
import pytest

from ptne_env.evaluation import PolicySpec, get_suite, run_suite
from ptne_env.field import laws as field_laws
from ptne_env.field.laws.pushes import observed_push

DT = 0.01


def observe(residuals, scale=10.0):
    """The push after each residual of one player with one component."""
    sight = SimpleNamespace(own_estimate=np.full((1, 1), scale), dt=np.full((1, 1), DT))
    memory = {"push": np.zeros((1, 1)), "push_steps": np.zeros((1, 1)), "dt": np.zeros((1, 1))}
    pushes = []
    for residual in [0.0, *residuals]:
        memory = observed_push(sight, memory, np.full((1, 1), residual))
        pushes.append(memory["push"].item())
    return pushes[1:], memory


def test_constant_push_is_known_after_its_first_step():
    pushes, memory = observe([0.02] * 5)
    assert pushes == pytest.approx([2.0] * 5)
    assert memory["push_steps"].item() == 5


def test_changed_push_replaces_the_mean():
    pushes, memory = observe([0.02] * 5 + [-0.01] * 2)
    assert pushes[-2:] == pytest.approx([-1.0, -1.0])
    assert memory["push_steps"].item() == 2


def test_rounding_of_estimates_is_averaged():
    rounding = 5e-7 * np.array([1, -1, 1, -1, 1, -1])
    pushes, _ = observe(0.02 + rounding)
    assert abs(pushes[-1] - 2.0) < 1e-5 < abs(pushes[0] - 2.0)


def test_residual_below_the_resolution_is_no_push():
    assert observe([5e-6] * 3)[0] == [0.0] * 3


def digits(track, law):
    """Mean digits on a few validation episodes; the audit of decisions runs beside."""
    results = run_suite("ptne-v1", [PolicySpec("mine", law)], tracks=[track], episodes=6, split="validation")
    assert not results.failures
    return results.samples[track, "mine"][get_suite("ptne-v1").track(track).metric].mean()


def test_bounds_that_stop_strategies_cost_no_digits():
    assert digits("robots", field_laws.ObserverRelay) == pytest.approx(12)
