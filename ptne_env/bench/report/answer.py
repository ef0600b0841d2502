"""The answer of a comparison: the entries that come closest, in three sentences and in one table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf, isfinite
from typing import TypeAlias

from ptne_env import learn as policies
from ptne_env.bench.report.tables import FIRST_MARGIN, Column, Table, Value, complete, first_places, mean_digits
from ptne_env.evaluation.metrics import share
from ptne_env.evaluation.policy_specs import POLICIES, learned_file
from ptne_env.evaluation.results import Results
from ptne_env.evaluation.suite import LAW, Track

SPECIALIST = "best specialist"
"""The column of the best policy of each track among those that play some tracks only."""

TUNED = "best of all laws"
"""The column of the law that is tuned for each scenario."""

_MOST_NAMED = 3
"""Leaders, and tracks of a leader, that a sentence names."""

_Leaders: TypeAlias = Mapping[tuple[str, ...], Sequence[Track]]


def answer(results: Results) -> tuple[str, ...]:
    """Three sentences: the entry that is first most often, the entries that are first elsewhere, what that is worth.

    Where no honest entry has a value, one sentence says why.

    Args:
        results: of a comparison or of another suite.
    """
    leading = leaders(results)
    if leading:
        return _first(results, leading), _others(results, leading), _worth(results)
    if results.failures:
        failing = list(dict.fromkeys(policy for _, policy in results.failures))
        return (f"{_listed(failing)} failed; the tables below name the steps and the errors.",)
    return ("No honest entry was run: coded entries stand apart, and oracles use information that players lack.",)


def leaders(results: Results) -> dict[tuple[str, ...], list[Track]]:
    """The fewest honest entries of which one is first on every track, most tracks first.

    An entry is first where it is the closest, or its interval comes within
    :data:`~ptne_env.bench.report.tables.FIRST_MARGIN` digits of the closest
    (:func:`~ptne_env.bench.report.tables.first_places`); where a tuned law is closer, none is first.

    Returns:
        The tracks by the names of the entries that are first there; several names where they are first on the same.
        Last come, by the name :data:`TUNED`, the tracks on which no entry is first.
    """
    firsts, honest = first_places(results), _honest(results)
    left = list(results.tracks)
    found: dict[tuple[str, ...], list[Track]] = {}
    while left and honest:
        led = {name: [track for track in left if track.name in firsts[name]] for name in honest}
        tracks = max(led.values(), key=len)
        if not tracks:
            break
        found[tuple(name for name in honest if led[name] == tracks)] = tracks
        left = [track for track in left if track not in tracks]
    if honest and (tuned := [track for track in left if TUNED in _reached(results, track)]):
        found[TUNED,] = sorted(tuned, key=lambda track: -_gap(results, track, _nearest(results, track)))
    return found


def own_policies(results: Results) -> list[str]:
    """The names of the policies that do not ship with the library."""
    shipped = set(policies.shipped())
    return [
        name
        for name, spec in results.policies.items()
        if POLICIES.get(name) != spec and learned_file(spec.training_seeds[0]) not in shipped
    ]


def answer_table(results: Results) -> Table:
    """The digits of the policies on the tracks, a row per track and a column per policy.

    First stand the leaders, then the law that is tuned for each track, the paper's law, the user's own policies, the
    best of the specialists, all other entries that play every track, the best first, and oracles last.

    Args:
        results: of a comparison or of another suite.
    """
    tracks, everywhere, own = results.tracks, complete(results), own_policies(results)
    winners = [name for names in leaders(results) for name in names if name in everywhere]
    specialists = [name for name in _honest(results) if name not in everywhere and name not in own]
    rest = sorted(
        everywhere,
        key=lambda name: (results.policies[name].division != "honest", -(mean_digits(results, name).mean or 0.0)),
    )
    shown = dict.fromkeys([*winners, TUNED, *filter(everywhere.__contains__, [LAW]), *own, SPECIALIST, *rest])
    columns = []
    for name in shown:
        names = specialists if name == SPECIALIST else [name]
        values = {track.name: _best_of(results, track, names) for track in tracks}
        columns.append(Column(name, "digits ± half of the 95 % interval", values))
    columns = [column for column in columns if column.is_filled]
    legends = {
        TUNED: f"the best law on validation episodes, with parameters tuned for the {_noun(results)}.",
        SPECIALIST: f"the best of the policies that play some {_noun(results)}s only.",
    }
    return Table(
        f"Digits at the deadline ± half of the 95 % interval, {_episodes(results)}; more than 12 are not counted",
        tuple(columns),
        dict.fromkeys((track.name for track in tracks), "honest"),
        notes=tuple(f"{column.label}: {legends[column.label]}" for column in columns if column.label in legends),
        subject=_noun(results),
    )


def _episodes(results: Results) -> str:
    """The numbers of episodes of the tracks of the answer, in words."""
    counts = sorted({results.episodes[track.name] for track in results.tracks})
    return f"{' to '.join(str(count) for count in dict.fromkeys([counts[0], counts[-1]]))} episodes"


def _best_of(results: Results, track: Track, names: Sequence[str]) -> Value:
    """The digits of the best of some policies on a track; a dash where none of them acts."""
    found = {name: digits for name in names if (digits := _digits(results, track, name)) is not None}
    return _value(results, track, max(found, key=found.__getitem__)) if found else Value()


def _value(results: Results, track: Track, policy: str) -> Value:
    return Value.plus_minus(results.summary(track.name, policy, track.metric))


def _digits(results: Results, track: Track, policy: str) -> float | None:
    summary = results.summary(track.name, policy, track.metric)
    return None if summary is None else summary.mean


def _honest(results: Results) -> list[str]:
    """The names of the policies whose estimates are present beliefs of players."""
    return [name for name, spec in results.policies.items() if spec.division == "honest"]


def _noun(results: Results) -> str:
    return "scenario" if results.suite.is_comparison else "track"


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


# --- sentences ------------------------------------------------------------------------------------------------------


def _first(results: Results, leading: _Leaders) -> str:
    """The entry that is first most often."""
    (names, tracks), count = next(iter(leading.items())), len(results.tracks)
    places = ", ".join(_place(results, names, track) for track in tracks)
    where = f"{len(tracks)} of {count} {_noun(results)}s"
    if count == 1:
        where = places
    elif len(tracks) <= min(_MOST_NAMED, count - 1):
        where += f": {places}"
    subject = _named(results, names)
    sentence = (
        f"{subject.capitalize() if TUNED in names else subject} {'is' if len(names) == 1 else 'are each'} the closest "
        f"to the Nash equilibrium at the deadline, up to {FIRST_MARGIN:g} digits and the 95 % interval, on {where}"
    )
    if (board := results.leaderboard) is not None and board.overall:
        best = board.overall[0]
        who = "it" if names == (best.policy,) else best.policy
        sentence += f"; {who} has the highest score, {Value.of(best.score, share)}"
    return f"{sentence}."


def _shortened(places: Sequence[str]) -> str:
    """The first few places, and the number of the others."""
    more = len(places) - _MOST_NAMED
    return ", ".join(places[:_MOST_NAMED]) + f" and {more} more" * (more > 0)


def _place(results: Results, names: Sequence[str], track: Track) -> str:
    """A track with the most digits of the policies that are first there, and of the tuned law, or entry, behind."""
    policy = min(names, key=lambda name: _gap(results, track, name))
    found = f"{_value(results, track, policy)} digits"
    if policy == TUNED:
        nearest = _nearest(results, track)
        found += f"; {nearest}: {_value(results, track, nearest)}"
    elif TUNED in _reached(results, track):
        found += f"; the {TUNED}, tuned for it: {_value(results, track, TUNED)}"
    return f"{track.name} ({found})"


def _others(results: Results, leading: _Leaders) -> str:
    """The entries that are first elsewhere, and how near the user's own policies come; else the next entry."""
    _, *rest = leading.items()
    clauses = []
    if rest:
        named = [
            f"{_named(results, names, kinds=True)} on {_shortened([_place(results, names, track) for track in tracks])}"
            for names, tracks in rest[:_MOST_NAMED]
        ]
        if left := sum(len(tracks) for _, tracks in rest[_MOST_NAMED:]):
            named.append(f"others on {left} more")
        clauses.append(f"Elsewhere the closest is {_listed(named)}")
    led = {name for names in leading for name in names}
    behind = {name: found for name in _honest(results) if name not in led and (found := _gaps(results, name))}
    own = [name for name in own_policies(results) if name in behind]
    nearest = sorted(behind, key=lambda name: min(behind[name].values()))[:1]
    firsts = first_places(results)
    for name in own or nearest * (not rest):
        track, count = min(behind[name], key=behind[name].__getitem__), len(results.tracks)
        nearest_on = f"comes nearest to the closest on {track}," if count > 1 else "ends"
        clause = f"{nearest_on} {behind[name][track]:.2f} digits behind it"
        clauses.append(f"{name} {f'is as close on {_shortened(firsts[name])}' if firsts[name] else clause}")
    return f"{'; '.join(clauses) or 'No other honest entry was run'}."


def _named(results: Results, names: Sequence[str], *, kinds: bool = False) -> str:
    """Names in a sentence, with or without the kind of learned entries."""
    shown = {TUNED: f"a law that is tuned for the {_noun(results)}"}
    if kinds:
        files = (name for name in names if name != TUNED and learned_file(results.policies[name].training_seeds[0]))
        shown |= {name: f"the learned {name}" for name in files}
    return _listed([shown.get(name, name) for name in names])


def _reached(results: Results, track: Track) -> dict[str, float]:
    """The digits on a track of the honest entries, and of the tuned law, that act there."""
    names = [*_honest(results), TUNED]
    return {name: digits for name in names if (digits := _digits(results, track, name)) is not None}


def _gap(results: Results, track: Track, policy: str) -> float:
    """The digits by which the closest is ahead of a policy on a track; infinite where the policy does not act."""
    reached = _reached(results, track)
    return max(reached.values()) - reached[policy] if policy in reached else inf


def _gaps(results: Results, policy: str) -> dict[str, float]:
    """The same by track, where the policy acts."""
    gaps = {track.name: _gap(results, track, policy) for track in results.tracks}
    return {track: gap for track, gap in gaps.items() if isfinite(gap)}


def _nearest(results: Results, track: Track) -> str:
    """The name of the closest honest entry on a track."""
    return min(_honest(results), key=lambda name: _gap(results, track, name))


def _worth(results: Results) -> str:
    """The meaning of a digit, by the distance of the paper's law from the closest."""
    meaning = "A digit is a factor of ten in the distance of the players' estimates from the equilibrium"
    gaps = _gaps(results, LAW)
    if not gaps:
        return f"{meaning}."
    firsts = first_places(results).get(LAW, ())
    gaps = {track: gap for track, gap in gaps.items() if track not in firsts}
    if not gaps:
        return f"{meaning}; nothing is clearly ahead of the paper's law ({LAW})."
    least, most = min(gaps, key=gaps.__getitem__), max(gaps, key=gaps.__getitem__)
    span = (
        f"{gaps[least]:.2f} ({least}) to {gaps[most]:.2f} digits ({most})"
        if len(gaps) > 1
        else f"{gaps[most]:.2f} digits"
    )
    return f"{meaning}; the paper's law ({LAW}) ends {span} behind the closest."
