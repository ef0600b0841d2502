"""Tables of a certificate and of a verification."""

from __future__ import annotations

from ptne_env.evaluation.metrics import number
from ptne_env.execution.verification import Repetition, Verification
from ptne_env.report.tables import Table, text_table
from ptne_env.theory import Certificate

_SHOWN_DIFFERENCES = 10
"""Differences of a verification that are listed."""


def certificate_tables(certificate: Certificate) -> tuple[Table, Table]:
    """The paper's assumptions with the number that decides each, and the predictions."""
    assumptions = text_table(
        f"{certificate.scenario}: what the paper assumes",
        "",
        ("verdict", "assumption", "decided by"),
        (
            (check.name, check.verdict, check.statement, f"{number(check.value)}: {check.meaning}")
            for check in certificate.assumptions
        ),
    )
    clock, step = ("s", "Θ") if certificate.clock == "effective" else ("t", "Δt")
    kind = "exact" if certificate.digits_are_exact else "not exact, see the notes"
    stable = "none" if certificate.largest_stable_step is None else number(certificate.largest_stable_step)
    rows = {"the law's own condition": "it promises nothing"}
    if (condition := certificate.condition) is not None:
        verdict = "holds" if condition.holds else "fails (sufficient, not necessary)"
        rows = {condition.name: f"{number(condition.value)} against {number(condition.bound)}: {verdict}"}
    if certificate.rate is not None:
        rows[f"rate r, error ~ e^(−r {clock})"] = number(certificate.rate)
    if certificate.digits is not None:
        rows["digits at the deadline"] = f"{number(certificate.digits)} ({kind})"
    if certificate.largest_step is not None:
        rows[f"largest step {step}, and the largest stable one"] = f"{number(certificate.largest_step)}, {stable}"
    rows["short of the deadline, 1 − t_K/T"] = f"{certificate.shortfall:.3%}"
    notes = tuple(f"Note: {note}" for note in certificate.notes)
    title = f"{certificate.scenario}: {certificate.law}"
    return assumptions, text_table(title, "prediction", ("value",), rows.items(), notes)


def verification_tables(verified: Verification) -> tuple[Table, Table]:
    """Whether the tables of results follow from their samples, and the jobs that were run again."""
    shown = [("differs", text) for text in verified.differences[:_SHOWN_DIFFERENCES]]
    if (hidden := len(verified.differences) - _SHOWN_DIFFERENCES) > 0:
        shown.append(("differs", f"{hidden} more numbers or texts"))
    rebuilt = text_table(
        "Tables that were rebuilt from the samples",
        "",
        ("verdict", ""),
        ((str(index + 1), *texts) for index, texts in enumerate(shown or [("agree", "every number follows")])),
    )
    rows = (
        (
            f"{each.track}: {each.policy}" + f", training seed {each.training_seed}" * (each.training_seed > 0),
            _verdict(each, same_arithmetic=verified.same_arithmetic),
            number(each.difference),
            each.reason or "",
        )
        for each in verified.repetitions
    )
    title = f"{len(verified.repetitions)} of {verified.jobs} jobs were run again"
    note = "Processor, BLAS or libraries are others: rounding differs, and jobs agree where intervals overlap."
    notes = () if verified.same_arithmetic else (note,)
    return rebuilt, text_table(title, "job", ("verdict", "largest difference", "reason"), rows, notes)


def _verdict(repetition: Repetition, *, same_arithmetic: bool) -> str:
    if not repetition.agrees:
        return "differs" if repetition.reason is None else "fails"
    return "reproduces" if same_arithmetic else "agrees within its intervals"
