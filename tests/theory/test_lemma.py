"""Lemma 1: the transformations that ship satisfy it, and a violated condition is named."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from worlds import world_and_encoder

from ptne_env.theory import (
    LemmaViolationError,
    check_assumptions,
    check_time_transformation,
    monotonicity_constants,
)
from ptne_env.world.clock import Exponential, HyperbolicTangent, Rational


@given(st.sampled_from([Exponential, Rational, HyperbolicTangent]), st.floats(0.1, 50))
def test_every_transformation_satisfies_the_lemma(kind, deadline):
    check_time_transformation(kind(deadline))


def broken(**methods):
    """The exponential for T = 2 with some methods replaced."""
    transformation = Exponential(2.0)
    vars(transformation).update(methods)
    return transformation


def saturating(limit, rate, start=0.0):
    """λ(s) = start + limit (1 − e^{−rate s}) and its derivative."""
    return {
        "time": lambda s: start + limit * (1 - np.exp(-rate * np.asarray(s))),
        "derivative": lambda s: limit * rate * np.exp(-rate * np.asarray(s)),
    }


BROKEN = {
    "does not start at 0": (broken(**saturating(1.9, 2 / 1.9, start=0.1)), r"\(7a\) λ\(0\) = 0"),
    "starts with another slope": (broken(**saturating(2, 2)), r"\(7a\) λ'\(0\) = T"),
    "has another derivative": (
        broken(derivative=lambda s: 2 / (1 + np.asarray(s)) ** 2),
        r"\(7a\) λ is differentiable with derivative λ'",
    ),
    "turns back": (
        broken(time=lambda s: 2 * np.sin(np.asarray(s)), derivative=lambda s: 2 * np.cos(np.asarray(s))),
        r"\(7b\) λ is strictly increasing",
    ),
    "stalls": (
        broken(
            time=lambda s: 2 - 2 * np.maximum(1 - np.asarray(s) / 3, 0) ** 3,
            derivative=lambda s: 2 * np.maximum(1 - np.asarray(s) / 3, 0) ** 2,
        ),
        r"\(7b\) λ is strictly increasing",
    ),
    "ends beyond the deadline": (broken(**saturating(4, 0.5)), r"\(7c\) λ\(s\) → T"),
    "ends before the deadline": (broken(**saturating(1, 2)), r"\(7c\) λ\(s\) → T"),
    "never slows down": (
        broken(derivative=lambda s: np.where(np.asarray(s) > 100, 1.0, 2 * np.exp(-np.asarray(s)))),
        r"\(7c\) λ'\(s\) → 0",
    ),
    "is not a number": (broken(time=lambda s: np.asarray(s) * np.nan), r"\(7a\) λ\(0\) = 0"),
    "is not a number far out": (
        broken(time=lambda s: np.where(np.asarray(s) > 6, np.nan, Exponential(2.0).time(s))),
        r"\(7c\) λ\(s\) → T",
    ),
    "has another inverse": (broken(inverse=lambda t: np.asarray(t) / (2 - np.asarray(t))), r"λ\^\{-1\}\(λ\(s\)\) = s"),
}


def test_formula_that_overflows_far_out_satisfies_the_lemma():
    formulas = {
        "time": lambda s: 2 * np.sinh(s) / np.cosh(s),
        "derivative": lambda s: 2 / np.cosh(s) ** 2,
        "inverse": lambda t: np.arctanh(np.asarray(t) / 2),
    }
    assert abs(check_time_transformation(broken(**formulas))) < 1e-4


def test_a_limit_that_comes_slower_than_numbers_show_is_a_doubt():
    formulas = {
        "time": lambda s: 2 - 2 / (1 + np.log1p(s)),
        "derivative": lambda s: 2 / (1 + s) / (1 + np.log1p(s)) ** 2,
        "inverse": lambda t: np.expm1(t / (2 - t)),
    }
    with pytest.warns(UserWarning, match=r"T − λ\(s\) is still 0\.135 s at s = 1e\+06: λ satisfies Lemma 1 only if"):
        assert check_time_transformation(broken(**formulas)) == pytest.approx(1 / (1 + np.log1p(1e6)))
    world, _ = world_and_encoder("energy")
    world.clock.__dict__["transformation"] = broken(**formulas)
    with pytest.warns(UserWarning, match="is still"):
        check = check_assumptions(world, monotonicity_constants(world.game))[0]
    assert check.verdict == "sampled only"


@pytest.mark.parametrize("name", BROKEN)
def test_violated_condition_of_the_lemma_is_named(name):
    transformation, condition = BROKEN[name]
    with pytest.raises(LemmaViolationError, match=f"violates {condition} of Lemma 1"):
        check_time_transformation(transformation)
