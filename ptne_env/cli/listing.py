"""``ptne list``: scenarios, policies, metrics and suites."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Any

import typer

from ptne_env.bench import report
from ptne_env.cli import options
from ptne_env.cli.app import app
from ptne_env.cli.console import check_writable, console, json_text, write_json
from ptne_env.evaluation import METRICS, suite_policies
from ptne_env.evaluation.metrics import Metric
from ptne_env.evaluation.suite import SUITES, get_suite
from ptne_env.world.catalogue import CATALOGUE, DESCRIPTIONS

_METRIC_FIELDS = [field.name for field in fields(Metric) if field.name not in ("value", "format")]


@app.command("list")
def list_(
    kind: Annotated[list[report.Kind] | None, typer.Argument(help="The kinds of names. All if left out.")] = None,
    json: options.Json = None,
) -> None:
    """Show the scenarios, policies, metrics and suites, each with a sentence."""
    check_writable(json)
    chosen = kind or list(report.Kind)
    data: dict[report.Kind, dict[str, Any]] = {
        report.Kind.SCENARIOS: {
            name: {"description": DESCRIPTIONS[name], **made.to_dict()} for name, made in CATALOGUE.items()
        },
        report.Kind.POLICIES: {
            each.name: {"description": each.description, **each.to_dict()} for each in suite_policies()
        },
        report.Kind.METRICS: {
            name: {field: getattr(metric, field) for field in _METRIC_FIELDS} for name, metric in METRICS.items()
        },
        report.Kind.SUITES: {name: get_suite(name).content() for name in SUITES},
    }
    write_json(json, json_text({each: data[each] for each in chosen}))
    console().print(report.catalogue(chosen))
