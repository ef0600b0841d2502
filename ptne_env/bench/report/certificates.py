"""Tables of a certificate."""

from __future__ import annotations

from string import Formatter
from typing import Any

from rich.console import Group
from rich.text import Text

from ptne_env.bench.report.terminal import empty_table
from ptne_env.evaluation.metrics import number
from ptne_env.theory import Certificate
from ptne_env.theory.certificate import DelayPrediction

_VERDICTS = {"holds": "green", "fails": "red"}

_PROMISES = (
    (
        ("monotonicity and Lipschitz constants", "ε = {constants_epsilon}, ι = {iota} ({constants_kind})"),
        ("smallest algebraic connectivity λ2", "{algebraic_connectivity}"),
        ("the law's own condition", "{no_condition}"),
        ("{condition_name}", "{condition_value} against {condition_bound}{condition_kind}: {condition_verdict}"),
        ("gains at the start", "{start_smallest} to {start_largest}: r = {start_rate}"),
        ("gains at T", "{deadline_smallest} to {deadline_largest}: r = {deadline_rate}"),
    ),
    (
        ("closed-loop rate r, error ~ e^(−r {time})", "{rate} ({rate_kind})"),
        ("  guaranteed by ε, ι, λ2 and κ alone", "≥ {guaranteed_rate} (bound)"),
        (
            "  of the sampled loop, second half",
            "{sampled_rate}; its mode is {dominant_share:.0%} of the error half-way",
        ),
        ("rate at which the input u decays", "{input_rate}"),
        ("velocity g(t) u as t → T", "{velocity}"),
        ("control energy ∫‖g u‖² dt", "{energy}"),
    ),
    (
        ("predicted digits at T, from the rate", "{digits_from_rate} (first order)"),
        ("predicted digits at T, sampled loop from this start", "{digits_sampled} ({digits_kind})"),
        ("  after the hold phase", "{digits_after_hold} ({digits_kind})"),
        ("digits gained by T from the worst start", "{worst_digits_gained} more than the start has ({digits_kind})"),
        ("digits at T guaranteed by ε, ι, λ2, κ and Θ alone", "≥ {guaranteed_digits} (bound)"),
        ("effective time to the deadline", "{effective_time}"),
        ("short of the deadline, 1 − t_K/T", "{shortfall:.3%}"),
    ),
    (
        ("largest step {step}", "{largest_step}"),
        ("largest stable step", "{no_stable_step}"),
        ("largest stable step", "{largest_stable_step}, {step_margin} times the largest"),
    ),
    (
        ("noise of std σ on messages: RMS distance at T", "{noise_overflow}"),
        ("noise of std σ on messages: RMS distance at T", "{noise_gain} σ"),
        ("  digits at T with σ = {noise_std:g}", "{noise_digits} (root mean square)"),
    ),
    (
        ("messages d steps late", "{delay_reach}"),
        ("  small-gain bound, of first order", "stable for d < {delay_bound} (bound)"),
        ("  digits at T with d = {delay_steps:g}", "{delay_digits} ({delay_kind})"),
    ),
)
"""Rows in groups: a statement and its value, made from :func:`_values`; a row without a value is left out."""


def certificate_tables(certificate: Certificate) -> Group:
    """A certificate for a terminal: the assumptions with the number that decides each, and the promises.

    Args:
        certificate: of :func:`~ptne_env.theory.certify`.

    Returns:
        Renderables that are 110 to 130 columns wide.
    """
    assumptions = empty_table(f"{certificate.scenario}: the paper's assumptions")
    for heading in ("", "assumption", "decided by", "value", "verdict"):
        assumptions.add_column(heading, justify="right" if heading == "value" else "left")
    for check in certificate.assumptions:
        assumptions.add_row(
            str(check.number), check.statement, check.meaning, number(check.value), _verdict(check.verdict)
        )
    lemma = certificate.lemma
    statement = "Lemma 1: λ is strictly increasing, λ → T, λ' → 0" + (f" ({lemma.reason})" if lemma.reason else "")
    assumptions.add_row("λ", statement, "limit of 1 − λ/T", number(lemma.remaining), _verdict(lemma.verdict))

    promises = empty_table(f"{certificate.scenario}: {certificate.law}", show_header=False)
    promises.add_column("promise", no_wrap=True)
    promises.add_column("value")
    values = _values(certificate)
    for rows in _PROMISES:
        promises.add_section()
        for statement, value in rows:
            if all(values.get(name) is not None for _, name, _, _ in _WRITER.parse(value) if name):
                promises.add_row(_WRITER.vformat(statement, (), values), _WRITER.vformat(value, (), values))
    notes = [Text(f"Note: {note}", style="yellow") for note in certificate.notes]
    return Group(assumptions, promises, *notes)


def _verdict(verdict: str) -> Text:
    return Text(verdict, style=_VERDICTS.get(verdict, "yellow"))


class _Writer(Formatter):
    """``str.format`` in which a number without a format of its own has three significant digits."""

    def format_field(self, value: Any, format_spec: str) -> str:
        return number(value) if isinstance(value, float) and not format_spec else format(value, format_spec)


_WRITER = _Writer()


def _condition_verdict(certificate: Certificate) -> str:
    condition = certificate.condition
    if condition is None or condition.holds:
        return "holds"
    return "fails (the law does not settle)" if condition.necessary else "fails (sufficient, not necessary)"


def _values(certificate: Certificate) -> dict[str, Any]:
    """The numbers of a certificate and of its parts, and its verdicts in words; ``None`` or absent where missing."""
    found = dict(vars(certificate))
    parts: dict[str, object] = {name: found[name] for name in ("constants", "condition", "noise", "delay")}
    parts |= {gains.instant: gains for gains in certificate.frozen_gains}
    for prefix, part in parts.items():
        found |= {f"{prefix}_{name}": value for name, value in vars(part).items()} if part else {}
    noise, delay = certificate.noise, certificate.delay
    return found | {
        "iota": certificate.constants.iota,
        "constants_kind": "exact" if certificate.constants.exact else "sampled bounds",
        "no_condition": None if certificate.condition else "it promises nothing",
        "condition_kind": "" if found.get("condition_exact") else ", from samples",
        "condition_verdict": _condition_verdict(certificate),
        "time": "s" if certificate.clock == "effective" else "t",
        "step": "Θ" if certificate.clock == "effective" else "Δt",
        "rate_kind": _kind(exact=certificate.rate_is_exact),
        "digits_kind": _kind(exact=certificate.digits_are_exact),
        "velocity": {True: "bounded", False: "unbounded", None: None}[certificate.velocity_bounded],
        "energy": {True: "finite", False: "infinite", None: None}[certificate.energy_finite],
        "no_stable_step": "none" if certificate.largest_step and certificate.largest_stable_step is None else None,
        "noise_overflow": "overflows" if noise and noise.gain is None else None,
        "noise_digits": noise.digits if noise and noise.std else None,
        "delay_reach": None if delay is None else _delay_reach(delay),
        "delay_digits": delay.digits if delay and delay.steps else None,
        "delay_kind": _kind(exact=delay is not None and delay.digits_are_exact),
    }


def _kind(*, exact: bool) -> str:
    return "exact" if exact else "see the notes"


def _delay_reach(delay: DelayPrediction) -> str:
    if delay.for_every_delay:
        return "stable for every d (shown by a sufficient condition)"
    if delay.margin is None:
        return "no statement: the graph switches, or unstable without delay"
    return f"stable up to d = {delay.margin} ({'tried no further' if delay.margin == delay.tried else 'exact'})"
