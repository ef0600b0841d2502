from decimal import Decimal, localcontext

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate

from ptne_env.world.clock import Exponential, HyperbolicTangent, Rational, StepClock

TRANSFORMATIONS = [Exponential, Rational, HyperbolicTangent]
SPACINGS = ["effective", "transformed", "physical"]
transformations = st.builds(lambda kind, deadline: kind(deadline), st.sampled_from(TRANSFORMATIONS), st.floats(0.1, 50))


@given(transformations, st.floats(0, 10))
def test_inverse_and_derivative_agree_with_the_transformation(transformation, s):
    t = transformation.time(s)
    assert 0 <= t < transformation.deadline
    slope = transformation.derivative(s)
    rounding = 4e-15 * transformation.deadline / slope  # rounding of t, in units of s
    assert transformation.inverse(t) == pytest.approx(s, abs=rounding + 1e-13)
    h = 1e-5
    assert (transformation.time(s + h) - transformation.time(max(s - h, 0))) / (s + h - max(s - h, 0)) == pytest.approx(
        slope, rel=2e-5, abs=1e-9 * transformation.deadline
    )


@pytest.mark.parametrize("kind", TRANSFORMATIONS)
def test_short_times_keep_their_digits(kind):
    """λ(s) = T s + O(s²) near 0, to the last bits of a float."""
    s = np.array([1e-17, 1e-13])
    assert kind(1.2).time(s) == pytest.approx(1.2 * s, rel=1e-12, abs=0)
    assert kind(1.2).inverse(1.2 * s) == pytest.approx(s, rel=1e-12, abs=0)


@pytest.mark.parametrize("deadline", [0.5, 1.2, 30.0])
@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.9, 0.9999])
def test_gain_has_its_closed_form(deadline, fraction):
    t = fraction * deadline
    assert Exponential(deadline).gain(t, 20.0) == pytest.approx(20 + 1 / (deadline - t), rel=1e-9)
    assert Rational(deadline).gain(t, 20.0) == pytest.approx(20 + deadline / (deadline - t) ** 2, rel=1e-9)
    assert HyperbolicTangent(deadline).gain(t, 20.0) == pytest.approx(20 + deadline / (deadline**2 - t**2), rel=1e-9)


@given(transformations, st.floats(0, 40), st.floats(0, 40))
def test_effective_time_has_an_inverse(transformation, constant, s):
    tau = transformation.effective_time(s, constant)
    assert transformation.from_effective_time(tau, constant) == pytest.approx(s, rel=1e-9, abs=1e-9)


# --- table of steps ---------------------------------------------------------------------------------------------------

clocks = st.builds(
    lambda transformation, spacing, gain, steps, s_end, hold: StepClock(
        transformation, gain=gain, steps=steps, s_end=s_end, spacing=spacing, hold_steps=hold
    ),
    transformations,
    st.sampled_from(SPACINGS),
    st.floats(0.1, 40),
    st.integers(1, 60),
    st.floats(0.5, 12),
    st.integers(0, 5),
)


@given(clocks)
def test_table_agrees_with_the_transformation(clock):
    steps, deadline = clock.steps, clock.deadline
    assert clock.t[:steps] == pytest.approx(clock.transformation.time(clock.s[:steps]), abs=1e-14 * deadline)
    assert clock.t[0] == clock.s[0] == 0
    assert clock.s[steps] == clock.s_end
    assert clock.time_reached == pytest.approx(float(clock.transformation.time(clock.s_end)), rel=1e-14)
    assert np.all(np.diff(clock.t) > 0)
    assert np.all(np.diff(clock.s[: steps + 1]) > 0)


@given(clocks)
def test_theta_is_ds_plus_c_dt_and_sums_to_the_effective_time(clock):
    steps = clock.steps
    reached = np.append(clock.t[:steps], clock.time_reached)
    dt, ds = np.diff(reached), np.diff(clock.s[: steps + 1])
    assert clock.dt[:steps] == pytest.approx(dt, rel=1e-12)
    assert clock.theta[:steps] == pytest.approx(ds + clock.gain * dt, rel=1e-12)
    assert clock.theta[:steps].sum() == pytest.approx(clock.s_end + clock.gain * clock.time_reached, rel=1e-12)
    assert clock.effective_time == pytest.approx(clock.theta[:steps].sum(), rel=1e-12)


@given(clocks)
def test_hold_phase_starts_at_the_deadline_with_the_mean_theta(clock):
    steps, hold = clock.steps, clock.hold_steps
    assert clock.total_steps == steps + hold
    assert clock.t[steps] == clock.deadline
    mean = clock.theta[:steps].mean()
    assert clock.theta[steps:-1] == pytest.approx(np.full(hold, mean), rel=1e-12)
    assert clock.dt[steps:-1] == pytest.approx(np.full(hold, mean / clock.gain), rel=1e-12)
    assert np.diff(clock.t[steps:]) == pytest.approx(clock.dt[steps:-1], rel=1e-9)
    assert np.all(clock.s[steps:] == clock.s_end)
    assert clock.theta[-1] == clock.dt[-1] == 0


@given(clocks)
def test_topology_clocks_continue_after_the_deadline(clock):
    steps, times = clock.steps, clock.topology_times
    assert np.array_equal(times["physical"], clock.t)
    assert np.array_equal(times["transformed"][:steps], clock.s[:steps])
    assert times["transformed"][steps:] == pytest.approx(
        clock.s_end + clock.gain * (clock.t[steps:] - clock.deadline), rel=1e-14
    )


@pytest.mark.parametrize("kind", TRANSFORMATIONS)
def test_each_spacing_divides_its_own_time_evenly(kind):
    for spacing in SPACINGS:
        clock = StepClock(kind(1.2), gain=20.0, steps=50, s_end=6.0, spacing=spacing)
        increments = {"effective": clock.theta[:-1], "transformed": np.diff(clock.s), "physical": clock.dt[:-1]}
        for name, values in increments.items():
            assert (np.ptp(values) <= 1e-8 * values.mean()) == (name == spacing)


def test_default_episode_stops_0_03_percent_short_of_the_deadline():
    clock = StepClock(Exponential(1.2), gain=20.0, steps=400, s_end=8.0)
    assert clock.shortfall == pytest.approx(np.exp(-8.0), rel=1e-9)
    assert clock.shortfall == pytest.approx(3.35e-4, rel=2e-3)


def test_without_constant_gain_theta_is_the_transformed_step():
    clock = StepClock(Exponential(1.2), gain=0.0, steps=10, s_end=5.0)
    assert clock.theta[:-1] == pytest.approx(np.full(10, 0.5))


PRECISE = {
    Exponential: lambda s: 1 - (-s).exp(),
    Rational: lambda s: s / (1 + s),
    HyperbolicTangent: lambda s: 2 / (1 + (-2 * s).exp()) - 1,
}
"""λ(s)/T of numbers with many digits."""


def precise_inverse(kind, tau, scale):
    """The s with s + C λ(s)/T = τ, bisected with 50 digits."""
    with localcontext(prec=50):
        low, high = Decimal(0), Decimal(tau)
        for _ in range(170):
            middle = (low + high) / 2
            is_low = middle + Decimal(scale) * PRECISE[kind](middle) < Decimal(tau)
            low, high = (middle, high) if is_low else (low, middle)
        return float(low)


@pytest.mark.parametrize("gain", [120.0, 1e6, 1e8])
@pytest.mark.parametrize("kind", TRANSFORMATIONS)
def test_the_inverse_of_effective_time_keeps_its_digits_where_the_gain_is_large(kind, gain):
    tau = gain * np.array([1e-6, 1e-3, 0.1, 0.5, 0.9])
    found = kind(1.0).from_effective_time(tau, gain)
    assert found == pytest.approx([precise_inverse(kind, value, gain) for value in tau.tolist()], rel=1e-13)


def test_a_step_with_the_input_held_solves_the_differential_equation():
    """dx/dt = (c + 1/(T − t)) u close to the deadline, by a solver of differential equations."""
    clock = StepClock(Exponential(1.2), gain=20.0, steps=400, s_end=8.0)
    k, x, u = 390, 3.0, -0.7
    span = (clock.t[k], clock.t[k] + clock.dt[k])
    solved = integrate.solve_ivp(lambda t, _: [(20.0 + 1 / (1.2 - t)) * u], span, [x], rtol=1e-12, atol=1e-12)
    assert x + clock.theta[k] * u == pytest.approx(solved.y[0, -1], abs=1e-10)
