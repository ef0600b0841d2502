"""Tune every law of the field for every scenario of the catalogue and every track of the suites, and try each law.

Run it as ``python baselines/tune_field.py``. It writes ``ptne_env/evaluation/tuned_laws.json``, where comparisons find
the laws and the means of their trials, by which the best law is chosen, and prints which parameters are at the edge of
their range. Searches and trials with an unchanged hash are kept: a changed law needs ``--again``.
"""

import json
import math
from collections.abc import Iterator
from functools import partial
from typing import Annotated

import typer
from common import Jobs, Ray
from rich.console import Console
from rich.progress import track as progress

from ptne_env.evaluation import Workers
from ptne_env.evaluation.run import validation_set
from ptne_env.evaluation.suite import SUITES, Suite, comparison, get_suite
from ptne_env.evaluation.tuning import FIELD, PUBLISHED, Tuned, Tuning, mean_of, published
from ptne_env.shared.files import write_atomically
from ptne_env.world.catalogue import CATALOGUE


def searches(suites: list[Suite]) -> Iterator[Tuning]:
    """A search for every member of the field on every track in which something is random."""
    for suite in suites:
        for track in suite.tracks:
            if track.world.is_random:
                yield from (Tuning(track, member, validation_set(suite, track)) for member in FIELD)


def is_published(search: Tuning) -> bool:
    """Whether the law is published, and its trial too; a law that cannot act has none."""
    if search.name not in published()["laws"]:
        return False
    law = search.find().law
    return law is None or search.reached(law) is not None


def tuned_and_tried(search: Tuning, *, again: bool) -> tuple[Tuned, float]:
    """The result of a search, and the mean of its trial; −∞ without one."""
    tuned = search.compute() if again else search.find()
    if tuned.law is None:
        return tuned, -math.inf
    trial = search.trial(tuned.law)
    return tuned, mean_of(trial, trial.compute())


def main(
    suite: Annotated[list[str] | None, typer.Option(help="A suite, or 'catalogue'; repeat for several.")] = None,
    *,
    again: Annotated[bool, typer.Option(help="Repeat all searches and trials.")] = False,
    jobs: Jobs = -1,
    ray: Ray = None,
) -> None:
    """Search and try, write the file after every search, and print parameters at edges."""
    names = suite or ["catalogue", *SUITES]
    wanted = list(searches([comparison(CATALOGUE) if name == "catalogue" else get_suite(name) for name in names]))
    missing = [search for search in wanted if again or not is_published(search)]
    laws, trials = published()["laws"], published()["trials"]
    runs = Workers(jobs, ray).run(partial(tuned_and_tried, again=again), [(search,) for search in missing])
    for index, (tuned, mean) in progress(runs, "tuning", total=len(missing), console=Console(stderr=True)):
        search = missing[index]
        laws[search.name] = tuned.to_dict()["law"]
        if tuned.law is not None and math.isfinite(mean):
            trials[search.trial_name(tuned.law)] = mean
        write_atomically(PUBLISHED, json.dumps(published(), indent=1, sort_keys=True) + "\n")
    for search in wanted:
        law = laws[search.name]
        if law is not None and (edges := search.member.edges(law["arguments"])):
            Console(soft_wrap=True).print(
                f"{search.track.name}: {law['target']} {law['arguments']}: at an edge: {', '.join(edges)}"
            )


if __name__ == "__main__":
    typer.run(main)
