"""Tune every law of the field for every scenario of the catalogue and every track of the suites.

Run it as ``python baselines/tune_field.py``. It writes ``ptne_env/experiments/tuned_laws.json``, where comparisons find
the laws, and prints which parameters are at the edge of their range. Searches with an unchanged hash are kept: a
changed law needs ``--again``.
"""

import json
from collections.abc import Iterator
from typing import Annotated

import typer
from common import Jobs, Ray
from rich.console import Console
from rich.progress import track as progress

from ptne_env.catalogue import CATALOGUE
from ptne_env.experiments import Workers
from ptne_env.experiments.run import validation_set
from ptne_env.experiments.suite import SUITES, Suite, comparison, get_suite
from ptne_env.experiments.tuning import FIELD, PUBLISHED, Tuning
from ptne_env.files import write_atomically


def searches(suites: list[Suite]) -> Iterator[Tuning]:
    """A search for every member of the field on every track in which something is random."""
    for suite in suites:
        for track in suite.tracks:
            if track.world.is_random:
                yield from (Tuning(track, member, validation_set(suite, track)) for member in FIELD)


def main(
    suite: Annotated[list[str] | None, typer.Option(help="A suite, or 'catalogue'; repeat for several.")] = None,
    *,
    again: Annotated[bool, typer.Option(help="Repeat all searches.")] = False,
    jobs: Jobs = -1,
    ray: Ray = None,
) -> None:
    """Search, write the file after every search, and print parameters at edges."""
    names = suite or ["catalogue", *SUITES]
    wanted = list(searches([comparison(CATALOGUE) if name == "catalogue" else get_suite(name) for name in names]))
    laws = json.loads(PUBLISHED.read_text(encoding="utf-8"))
    missing = [search for search in wanted if again or search.name not in laws]
    console = Console(stderr=True)
    runs = Workers(jobs, ray).run(Tuning.compute, [(search,) for search in missing])
    for index, tuned in progress(runs, "tuning", total=len(missing), console=console):
        laws[missing[index].name] = tuned.to_dict()["law"]
        write_atomically(PUBLISHED, json.dumps(laws, indent=1, sort_keys=True) + "\n")
    for search in wanted:
        law = laws[search.name]
        if law is not None and (edges := search.member.edges(law["arguments"])):
            Console(soft_wrap=True).print(
                f"{search.track.name}: {law['target']} {law['arguments']}: at an edge: {', '.join(edges)}"
            )


if __name__ == "__main__":
    typer.run(main)
