"""Tables for terminals, drawn with rich. Every function returns renderables and prints nothing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ptne_env.catalogue import CATALOGUE
from ptne_env.experiments import COMPARATIVE_METRICS, METRICS, PolicySpec, Results, suite_entries
from ptne_env.experiments.compare import PAPER_START, Record
from ptne_env.scenario import Scenario
from ptne_env.theory import Certificate
from ptne_env.world import World

_BLOCKS = {
    "How close": {
        "digits": "digits",
        "worst_decile_digits": "worst decile",
        "strategy_distance": "strategy distance",
        "estimate_distance": "estimate distance",
        "consensus_error": "consensus error",
        "settling_time": "settling time [s]",
        "settled_share": "settled share",
        "settling_time_1e_6": "settling to 1e-6 [s]",
        "settled_share_1e_6": "settled to 1e-6",
        "digits_after_hold": "digits after hold",
        "digits_gained": "digits gained",
    },
    "At what cost": {
        "input_energy": "input energy",
        "velocity_energy": "velocity energy",
        "peak_input": "peak |u|",
        "peak_velocity": "peak velocity",
        "saturated_share": "saturated share",
        "diverged_share": "diverged share",
        "microseconds_per_decision": "µs per decision",
    },
}
_Records: TypeAlias = Mapping[tuple[str, str, str], Record]

_NAME_WIDTH = 30
"""Columns that are kept for the names of policies."""

_CELL_WIDTH = 22
"""Columns that an interval of two numbers takes, with its margin."""

_PAIRED_WIDTH = 130
"""Columns in which a learned policy stands beside two laws; in fewer, each law has a table of its own."""

_LIST_WIDTH = 110
"""Columns in which the catalogue fits with the numbers of the clock."""

_VERDICTS = {"holds": "green", "fails": "red"}


def number(value: float | None) -> str:
    """A number with three significant digits, or a dash where there is none."""
    if value is None:
        return "–"
    if not math.isfinite(value):
        return {math.inf: "∞", -math.inf: "−∞"}.get(value, "–")
    if value == 0:
        return "0"
    if 1e-2 <= abs(value) < 999.5:
        return f"{value:#.3g}".rstrip(".")
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def share(value: float | None) -> str:
    """A score or a probability, whose zero is a matter of rounding, with three decimals; a dash where there is none."""
    return "–" if value is None else f"{value + 0.0:.3f}".replace("-0.000", "0.000")


def interval(record: Record) -> Text:
    """The mean, and under it the 95 % interval where the sample varies."""
    text = Text(number(record["mean"]), justify="right")
    if record["low"] != record["high"]:
        text.append(f"\n[{number(record['low'])}, {number(record['high'])}]", style="dim")
    return text


def comparison_tables(results: Results, width: int = 172) -> Group:
    """Tables per scenario: how close every policy came, and at what cost; ordered as in the comparison.

    Args:
        results: of the comparison.
        width: columns of the terminal; metrics that do not fit side by side go into further tables.
    """
    records = {(record["scenario"], record["policy"], record["metric"]): record for record in results.records}
    tables: list[Table | Text] = []
    for label in results.scenarios:
        if label.endswith(PAPER_START) and label.removesuffix(PAPER_START) in results.scenarios:
            continue  # stands below the random starts of its scenario
        starts = [name for name in (label, label + PAPER_START) if name in results.scenarios]
        for title, columns in _BLOCKS.items():
            tables += [
                _comparison_table(f"{label}: {title.lower()}", results, records, starts, metrics)
                for metrics in _fitting(list(columns), width)
            ]
        if label in results.tuned:
            groups = list(results.tuned[label])
            tables += [
                _paired_table(label, results, records, some)
                for some in ([groups] if width >= _PAIRED_WIDTH else [[group] for group in groups])
            ]
    if any(entry.interface.kind == "full" for entry in results.entries.values()):
        tables.append(Text("* an oracle: it sees what no player can see", style="dim"))
    return Group(*tables)


def _comparison_table(
    title: str, results: Results, records: _Records, starts: Sequence[str], metrics: Sequence[str]
) -> Table:
    headings = {metric: heading for block in _BLOCKS.values() for metric, heading in block.items()}
    table = empty_table(title)
    table.add_column("policy", no_wrap=True)
    for metric in metrics:
        table.add_column(Text(headings[metric]), justify="right")  # Text, because brackets are no markup
    for start in starts:
        names = [cell.policy for cell in results.cells if cell.scenario == start]
        episodes = records[start, names[0], "digits"]["episodes"]
        table.add_section()
        table.add_row(
            Text("the paper's start" if start.endswith(PAPER_START) else f"{episodes} starts", style="italic")
        )
        for name in names:
            oracle = name in results.entries and results.entries[name].interface.kind == "full"
            cells = (interval(records[start, name, metric]) for metric in metrics)
            table.add_row(Text(name + " *" * oracle), *cells)
    return table


def _paired_table(label: str, results: Results, records: _Records, groups: Sequence[str]) -> Table:
    """Learned policies against the tuned laws of some groups, paired by episode."""
    table = empty_table(f"{label}: learned policies against the laws, paired by episode")
    table.add_column("policy", no_wrap=True)
    for group in groups:
        entry = results.tuned[label][group]
        table.add_column(Text(f"digits over {entry.name}: {_call(entry)}"), justify="right")
        table.add_column(Text(f"probability of beating it ({group})"), justify="right")
    for name in results.entries:
        if (label, name, "digits_over_all_laws") in records:
            metrics = [f"{kind}_{group}_laws" for group in groups for kind in ("digits_over", "probability_of_beating")]
            table.add_row(Text(name), *(interval(records[label, name, metric]) for metric in metrics))
    return table


def _fitting(metrics: list[str], width: int) -> Iterable[list[str]]:
    """``metrics`` in groups whose columns fit into ``width`` without breaking an interval."""
    count = max(1, (width - _NAME_WIDTH) // _CELL_WIDTH)
    groups = -(-len(metrics) // count)
    size = -(-len(metrics) // groups)
    return (metrics[start : start + size] for start in range(0, len(metrics), size))


def empty_table(title: str, *, show_header: bool = True) -> Table:
    """A table in the style of all."""
    return Table(
        title=title, box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False, show_header=show_header, expand=False
    )


def certificate_tables(certificate: Certificate) -> Group:
    """What a certificate says: assumptions with the number that decides each, then the promises; 100 columns wide."""
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
    promises.add_column("what", no_wrap=True)
    promises.add_column("value")
    for rows in (_condition_rows, _rate_rows, _digit_rows, _step_rows, _noise_rows, _delay_rows):
        promises.add_section()
        for what, value in rows(certificate):
            promises.add_row(what, value)
    notes = [Text(f"Note: {note}", style="yellow") for note in certificate.notes]
    return Group(assumptions, promises, *notes)


def _verdict(verdict: str) -> Text:
    return Text(verdict, style=_VERDICTS.get(verdict, "yellow"))


_Rows: TypeAlias = Iterable[tuple[str, str]]


def _condition_rows(certificate: Certificate) -> _Rows:
    constants, condition = certificate.constants, certificate.condition
    kind = "exact" if constants.exact else "sampled bounds"
    yield (
        "monotonicity and Lipschitz constants",
        f"ε = {number(constants.epsilon)}, ι = {number(constants.iota)} ({kind})",
    )
    yield "smallest algebraic connectivity λ2", number(certificate.algebraic_connectivity)
    if condition is None:
        yield "the law's own condition", "it promises nothing"
    else:
        verdict = "holds" if condition.holds else "fails (sufficient, not necessary)"
        kind = "" if condition.exact else ", from samples"
        numbers = f"{number(condition.value)} against {number(condition.bound)}"
        yield condition.name, f"{numbers}{kind}: {verdict}"
    for gains in certificate.frozen_gains:
        when = "at the start" if gains.instant == "start" else "at T"
        yield f"gains {when}", f"{number(gains.smallest)} to {number(gains.largest)}: r = {number(gains.rate)}"


def _rate_rows(certificate: Certificate) -> _Rows:
    if certificate.rate is None:
        return
    time = "s" if certificate.clock == "effective" else "t"
    kind = "exact" if certificate.rate_is_exact else "see the notes"
    yield f"closed-loop rate r, error ~ e^(−r {time})", f"{number(certificate.rate)} ({kind})"
    if certificate.guaranteed_rate is not None:
        yield "  guaranteed by ε, ι, λ2 and κ alone", f"≥ {number(certificate.guaranteed_rate)} (bound)"
    if certificate.sampled_rate is not None and certificate.dominant_share is not None:
        share = f"its mode is {certificate.dominant_share:.0%} of the error half-way"
        yield "  of the sampled loop, second half", f"{number(certificate.sampled_rate)}; {share}"
    yield "rate at which the input u decays", number(certificate.input_rate)
    if certificate.velocity_bounded is not None:
        yield "velocity g(t) u as t → T", "bounded" if certificate.velocity_bounded else "unbounded"
        yield "control energy ∫‖g u‖² dt", "finite" if certificate.energy_finite else "infinite"


def _digit_rows(certificate: Certificate) -> _Rows:
    if certificate.digits_from_rate is not None:
        yield "predicted digits at T, from the rate", f"{number(certificate.digits_from_rate)} (first order)"
    if certificate.digits_sampled is not None:
        yield "predicted digits at T, sampled loop from this start", f"{number(certificate.digits_sampled)} (exact)"
    if certificate.digits_after_hold is not None:
        yield "  after the hold phase", f"{number(certificate.digits_after_hold)} (exact)"
    if certificate.worst_digits_gained is not None:
        yield "digits gained by T from the worst start", f"{number(certificate.worst_digits_gained)} (exact)"
    if certificate.guaranteed_digits is not None:
        yield "digits at T guaranteed by ε, ι, λ2, κ and Θ alone", f"≥ {number(certificate.guaranteed_digits)} (bound)"
    yield "effective time to the deadline", number(certificate.effective_time)
    yield "short of the deadline, 1 − t_K/T", f"{certificate.shortfall:.3%}"


def _step_rows(certificate: Certificate) -> _Rows:
    if certificate.largest_step is None:
        return
    stable = "none" if certificate.largest_stable_step is None else number(certificate.largest_stable_step)
    margin = "" if certificate.step_margin is None else f", {number(certificate.step_margin)} times the largest"
    yield f"largest step {'Θ' if certificate.clock == 'effective' else 'Δt'}", number(certificate.largest_step)
    yield "largest stable step", stable + margin


def _noise_rows(certificate: Certificate) -> _Rows:
    noise = certificate.noise
    if noise is None:
        return
    gain = "overflows" if noise.gain is None else f"{number(noise.gain)} σ"
    yield "noise of std σ on messages: RMS distance at T", gain
    if noise.std and noise.digits is not None:
        yield f"  digits at T with σ = {noise.std:g}", f"{number(noise.digits)} (root mean square)"


def _delay_rows(certificate: Certificate) -> _Rows:
    delay = certificate.delay
    if delay is None:
        return
    if delay.for_every_delay:
        yield "messages d steps late", "stable for every d (shown by a sufficient condition)"
    elif delay.margin is None:
        yield "messages d steps late", "no statement: the graph switches, or unstable without delay"
    else:
        reach = "tried no further" if delay.margin == delay.tried else "exact"
        yield "messages d steps late", f"stable up to d = {delay.margin} ({reach})"
    if delay.bound is not None:
        yield "  small-gain bound, of first order", f"stable for d < {number(delay.bound)} (bound)"
    if delay.steps and delay.digits is not None:
        yield f"  digits at T with d = {delay.steps}", f"{number(delay.digits)} (exact)"


def scenario_table(width: int = 172) -> Table:
    """The catalogue.

    Args:
        width: columns of the terminal; in a narrow one the numbers of the clock are left out.
    """
    clock = {"T [s]": "deadline", "c [1/s]": "gain", "steps": "steps", "s_end": "s_end"} if width >= _LIST_WIDTH else {}
    table = empty_table("Scenarios")
    table.add_column("name", no_wrap=True)
    for heading in ("game", "graph", *clock):
        table.add_column(Text(heading), overflow="fold")  # Text, because brackets are no markup
    for name, scenario in CATALOGUE.items():
        table.add_row(
            name,
            f"{type(World(scenario).game).__name__}, {World(scenario).game.num_players} players",
            _describe_signal(scenario),
            *(f"{getattr(scenario, field):g}" for field in clock.values()),
        )
    return table


def entry_table() -> Table:
    """The laws and the shipped learned policies."""
    table = empty_table("Policies")
    table.add_column("name", no_wrap=True)
    table.add_column("interface")
    table.add_column("policy", overflow="fold")
    for entry in suite_entries():
        policy = f"learned on {', '.join(sorted(entry.scenarios))}" if entry.scenarios else _call(entry)
        mode = "" if entry.interface.action_mode == "input" else f", {entry.interface.action_mode}"
        table.add_row(entry.name, f"{entry.interface.kind}{mode}", policy)
    return table


def _call(entry: PolicySpec) -> str:
    """The law of an entry with its arguments; with spaces, at which a narrow column breaks."""
    policy = entry.to_dict()["policy"]
    arguments = ", ".join(f"{name}={value:g}" for name, value in policy["arguments"].items())
    return f"{policy['target'].partition(':')[2]} ({arguments})".removesuffix(" ()")


def metric_table() -> Table:
    """Every metric and what it means."""
    table = empty_table("Metrics")
    table.add_column("name")
    table.add_column("meaning")
    for name, meaning in ({**METRICS, **COMPARATIVE_METRICS}).items():
        table.add_row(name, meaning)
    return table


def _describe_signal(scenario: Scenario) -> str:
    topology = World(scenario).topology
    if topology.is_fixed:
        return f"fixed, λ2 = {number(topology.union.algebraic_connectivity)}"
    unit = "s of t" if topology.clock == "physical" else "of s"
    return f"{len(topology.graphs)} modes, {number(topology.mean_dwell)} {unit} each"
