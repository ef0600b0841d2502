"""Tables of a certificate and of a check."""

from __future__ import annotations

from ptne_env.bench.report.tables import Cell, Column, Table, text_table
from ptne_env.evaluation.check import Check, Repetition
from ptne_env.evaluation.metrics import number
from ptne_env.theory import Certificate

_SHOWN_DIFFERENCES = 10
"""Differences of a check that are listed."""


def certificate_tables(certificate: Certificate) -> tuple[Table, Table]:
    """The paper's assumptions with the number that decides each, and the predictions.

    Args:
        certificate: of :func:`~ptne_env.theory.certify`.
    """
    assumptions = text_table(
        f"{certificate.scenario}: what the paper assumes",
        "",
        ("verdict", "assumption", "value", "of"),
        (
            (check.name, check.verdict, check.statement, number(check.value), check.meaning)
            for check in certificate.assumptions
        ),
    )
    clock, step = ("s", "Θ") if certificate.clock == "effective" else ("t", "Δt")
    kind = "exact" if certificate.digits_are_exact else "see the notes"
    stable = "none" if certificate.largest_stable_step is None else number(certificate.largest_stable_step)
    rows = {"the law's own condition": "it promises nothing"}
    if (condition := certificate.condition) is not None:
        verdict = "holds" if condition.holds else "fails"
        if not condition.holds:
            verdict += " (the law does not settle)" if condition.necessary else " (sufficient, not necessary)"
        rows = {condition.name: f"{number(condition.value)} against {number(condition.bound)}: {verdict}"}
    if certificate.rate is not None:
        rows[f"rate r, error ~ e^(−r {clock})"] = number(certificate.rate)
    if certificate.digits is not None:
        rows["digits at the deadline"] = f"{number(certificate.digits)} ({kind})"
    if certificate.largest_step is not None:
        rows[f"largest step {step}, and the largest stable one"] = f"{number(certificate.largest_step)}, {stable}"
    rows["short of the deadline, 1 − t_K/T"] = f"{certificate.shortfall:.3%}"
    predictions = text_table(f"{certificate.scenario}: {certificate.law}", "prediction", ("value",), rows.items())
    notes = tuple(f"Note: {note}" for note in certificate.notes)
    return assumptions, Table(predictions.caption, predictions.subject, predictions.rows, predictions.columns, notes)


def check_tables(check: Check, tolerance: float) -> tuple[Table, Table]:
    """Whether the tables of results follow from their jobs, and the jobs that were run again.

    Args:
        check: of :func:`~ptne_env.evaluation.check.check`.
        tolerance: the largest difference that counts as the same.
    """
    shown = [("differs", text) for text in check.differences[:_SHOWN_DIFFERENCES]]
    if (hidden := len(check.differences) - _SHOWN_DIFFERENCES) > 0:
        shown.append(("differs", f"{hidden} more numbers or texts"))
    found = [*(shown or [("agree", "every number follows from the stored jobs")])]
    found += [("not repeated", text) for text in check.missing]
    rebuilt = text_table(
        "Tables that were rebuilt from the stored jobs",
        "",
        ("verdict", ""),
        ((str(index + 1), *texts) for index, texts in enumerate(found)),
    )
    rows = {
        f"{repetition.job.track.name}: {repetition.job.policy.name}"
        + f", training seed {repetition.job.training_seed}" * (repetition.job.training_seed > 0): repetition
        for repetition in check.repetitions
    }
    columns = {
        "largest difference": lambda repetition: Cell.of(repetition.difference),
        "published score": lambda repetition: Cell.of(repetition.published),
        "fresh score": lambda repetition: Cell.of(repetition.fresh),
        "p": lambda repetition: Cell.of(repetition.probability),
        "verdict": lambda repetition: Cell.words(_verdict(repetition, tolerance)),
    }
    jobs = Table(
        "Jobs that were run again, on the published episodes and on fresh ones",
        "job",
        tuple(rows),
        tuple(Column(label, {name: cell(row) for name, row in rows.items()}) for label, cell in columns.items()),
        tuple(f"failed: {name}: {row.failure}" for name, row in rows.items() if row.failure is not None),
    )
    return rebuilt, jobs


def _verdict(repetition: Repetition, tolerance: float) -> str:
    if repetition.knows_episodes:
        return "too good: better on the published episodes than on fresh ones"
    if repetition.difference > tolerance:
        return "differs" if repetition.failure is None else "fails"
    return "reproduces" if repetition.failure is None else "fails again"
