"""Tables of certificates: a row per promise that exists, with its number."""

import io
from dataclasses import replace

import pytest
from rich.console import Console

from ptne_env import FactorySpec, get_scenario
from ptne_env.bench.report import certificate_tables
from ptne_env.evaluation.metrics import number
from ptne_env.theory import certify


def rows(certificate):
    stream = io.StringIO()
    Console(file=stream, width=200).print(certificate_tables(certificate))
    lines = [line.strip().split("  ") for line in stream.getvalue().splitlines() if "  " in line.strip()]
    return {line[0]: line[-1].strip() for line in lines}


@pytest.fixture(scope="module")
def static():
    return certify(get_scenario("energy", hold_steps=50), noise_std=1e-3, delay_steps=2)


def test_static_law_has_every_promise(static):
    table = rows(static)
    assert table["monotonicity and Lipschitz constants"] == "ε = 2.10, ι = 2.60 (exact)"
    assert table["κ > (ι²/ε + ι)/λ2"] == "2.00 against 4.21: fails (sufficient, not necessary)"
    assert table["closed-loop rate r, error ~ e^(−r s)"] == f"{number(static.rate)} (exact)"
    assert table["of the sampled loop, second half"].endswith("of the error half-way")
    assert table["velocity g(t) u as t → T"] == "unbounded"
    assert table["control energy ∫‖g u‖² dt"] == "infinite"
    assert table["predicted digits at T, sampled loop from this start"] == f"{number(static.digits_sampled)} (exact)"
    assert table["after the hold phase"] == f"{number(static.digits_after_hold)} (exact)"
    gained = f"{number(static.worst_digits_gained)} more than the start has (exact)"
    assert table["digits gained by T from the worst start"] == gained
    assert table["short of the deadline, 1 − t_K/T"] == f"{static.shortfall:.3%}"
    margin = f"{number(static.largest_stable_step)}, {number(static.step_margin)} times the largest"
    assert table["largest stable step"] == margin
    assert table["digits at T with σ = 0.001"] == f"{number(static.noise.digits)} (root mean square)"
    assert table["digits at T with d = 2"] == f"{number(static.delay.digits)} (exact)"
    assert "guaranteed by ε, ι, λ2 and κ alone" not in table


def test_digits_of_steps_that_amplify_errors_refer_to_the_notes():
    certificate = certify(get_scenario("energy", steps=130, hold_steps=5), delay_steps=2)
    table = rows(certificate)
    digits = number(certificate.digits_sampled)
    assert table["predicted digits at T, sampled loop from this start"] == f"{digits} (see the notes)"
    for statement in ("after the hold phase", "digits gained by T from the worst start", "digits at T with d = 2"):
        assert table[statement].endswith("(see the notes)")


def test_larger_gain_has_guarantees():
    certificate = certify(get_scenario("energy"), 5.0)
    table = rows(certificate)
    assert table["guaranteed by ε, ι, λ2 and κ alone"] == f"≥ {number(certificate.guaranteed_rate)} (bound)"
    assert table["digits at T guaranteed by ε, ι, λ2, κ and Θ alone"].startswith("≥ ")
    assert "digits at T with d = 0" not in table


def test_conditions_that_are_necessary_say_that_the_law_does_not_settle():
    name = "gradient play with delays settles (up to η = 0.264): ρ < 1"
    fails = rows(certify(get_scenario("oligopoly"), law=FactorySpec.of("ptne_env.field.laws:RoutedUnknown", step=0.3)))
    assert fails[name].endswith("against 1.00: fails (the law does not settle)")
    holds = rows(certify(get_scenario("oligopoly"), law=FactorySpec.of("ptne_env.field.laws:RoutedUnknown", step=0.2)))
    assert holds[name].endswith("against 1.00: holds")


def test_the_grounded_condition_shows_its_eigenvalue():
    table = rows(certify(get_scenario("energy"), law="Grounded"))
    assert table["κ > ((ι + √(N−1) ι_F)²/(4ε) + √(N−1) ι)/λ, λ = 0.586"].startswith("2.00 against 18.7: fails")


def test_zero_input_promises_nothing():
    table = rows(certify(get_scenario("energy"), law=FactorySpec.of("ptne_env.laws:ZeroInput")))
    assert table["the law's own condition"] == "it promises nothing"
    assert table["largest stable step"] == "none"
    assert table["messages d steps late"].startswith("no statement")


def test_adaptive_law_has_its_gains_at_both_ends():
    certificate = certify(get_scenario("energy"), law=FactorySpec.of("ptne_env.laws:Adaptive"))
    table = rows(certificate)
    for statement, gains in zip(("gains at the start", "gains at T"), certificate.frozen_gains, strict=True):
        expected = f"{number(gains.smallest)} to {number(gains.largest)}: r = {number(gains.rate)}"
        assert table[statement] == expected


def test_physical_clock_has_its_own_symbols():
    certificate = certify(get_scenario("energy", gain=0.0, s_end=8), law=FactorySpec.of("ptne_env.laws:CorollaryOne"))
    table = rows(certificate)
    assert certificate.clock == "physical"
    assert "closed-loop rate r, error ~ e^(−r t)" in table
    assert "largest step Δt" in table


@pytest.mark.parametrize(
    ("margin", "every", "text"),
    [
        (3, False, "stable up to d = 3 (exact)"),
        (9, False, "stable up to d = 9 (tried no further)"),
        (3, True, "every d"),
    ],
)
def test_reach_of_late_messages(static, margin, every, text):
    delay = replace(static.delay, margin=margin, tried=9, for_every_delay=every)
    assert text in rows(replace(static, delay=delay))["messages d steps late"]


def test_overflow_of_noise_and_missing_rows(static):
    table = rows(replace(static, noise=replace(static.noise, gain=None, std=0.0), delay=None, largest_step=None))
    assert table["noise of std σ on messages: RMS distance at T"] == "overflows"
    assert not {"digits at T with σ = 0", "messages d steps late", "largest step Θ"} & table.keys()
