"""``ptne list``: scenarios, policies, metrics and suites."""

from __future__ import annotations

from dataclasses import fields

from ptne_env import report
from ptne_env.catalogue import CATALOGUE
from ptne_env.cli import options
from ptne_env.cli.app import app
from ptne_env.cli.console import console, json_text, write_json
from ptne_env.experiments import METRICS, suite_policies
from ptne_env.experiments.metrics import Metric
from ptne_env.experiments.suite import SUITES, get_suite

_METRIC_FIELDS = [field.name for field in fields(Metric) if field.name not in ("value", "format")]


@app.command("list")
def list_(json: options.Json = None) -> None:
    """Show the scenarios, policies, metrics and suites."""
    write_json(
        json,
        json_text(
            {
                "scenarios": {name: scenario.to_dict() for name, scenario in CATALOGUE.items()},
                "policies": {policy.name: policy.to_dict() for policy in suite_policies()},
                "metrics": {
                    name: {field: getattr(metric, field) for field in _METRIC_FIELDS}
                    for name, metric in METRICS.items()
                },
                "suites": {name: get_suite(name).content() for name in SUITES},
            }
        ),
    )
    screen = console()
    screen.print(report.catalogue_tables(screen.width))
