"""The answer of a comparison: the entries that come closest, in three sentences and in one table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

from ptne_env import policies
from ptne_env.experiments.metrics import share
from ptne_env.experiments.policy_specs import POLICIES, learned_file
from ptne_env.experiments.results import Results
from ptne_env.experiments.suite import LAW, PAPER_START, Track
from ptne_env.report.tables import FIRST_MARGIN, Column, Table, Value, complete, first_places

SPECIALIST = "best specialist"
"""The column of the best policy of each track among those that play some tracks only."""

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


def compared(results: Results) -> tuple[Track, ...]:
    """The tracks of the answer: all, but of a scenario with random starts not the paper's own start."""
    return tuple(
        track
        for track in results.tracks
        if not (track.name.endswith(PAPER_START) and track.name.removesuffix(PAPER_START) in results.episodes)
    )


def leaders(results: Results) -> dict[tuple[str, ...], list[Track]]:
    """The fewest honest entries of which one is first on every track of :func:`compared`, most tracks first.

    An entry is first where it is the closest, or within :data:`~ptne_env.report.tables.FIRST_MARGIN` digits of the
    closest (:func:`~ptne_env.report.tables.first_places`).

    Returns:
        The tracks by the names of the entries that are first there; several names where they are first on the same.
    """
    firsts, honest = first_places(results), _honest(results)
    left = list(compared(results))
    found: dict[tuple[str, ...], list[Track]] = {}
    while left and honest:
        led = {name: [track for track in left if track.name in firsts[name]] for name in honest}
        tracks = max(led.values(), key=len)
        if not tracks:
            break
        found[tuple(name for name in honest if led[name] == tracks)] = tracks
        left = [track for track in left if track not in tracks]
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
    """The digits of the policies on the tracks of :func:`compared`, a row per track and a column per policy.

    First stand the leaders, then the paper's law, the user's own policies, the best of the specialists, all other
    entries that play every track, and oracles last.

    Args:
        results: of a comparison or of another suite.
    """
    tracks, everywhere, own = compared(results), complete(results), own_policies(results)
    winners = [name for names in leaders(results) for name in names if name in everywhere]
    specialists = [name for name in _honest(results) if name not in everywhere and name not in own]
    rest = sorted(everywhere, key=lambda name: results.policies[name].division != "honest")
    shown = dict.fromkeys([*winners, *filter(everywhere.__contains__, [LAW]), *own, SPECIALIST, *rest])
    columns = []
    for name in shown:
        names = specialists if name == SPECIALIST else [name]
        values = {track.name: _best_of(results, track, names) for track in tracks}
        columns.append(Column(name, "digits ± half of the 95 % interval", values))
    legend = f"{SPECIALIST}: the best of the policies that play some {_noun(results)}s only."
    columns = [column for column in columns if column.is_filled]
    return Table(
        f"Digits at the deadline ± half of the 95 % interval, {_episodes(results)}; more than 12 are not counted",
        tuple(columns),
        dict.fromkeys((track.name for track in tracks), "honest"),
        notes=(legend,) * any(column.label == SPECIALIST for column in columns),
        subject=_noun(results),
    )


def _episodes(results: Results) -> str:
    """The numbers of episodes of the tracks of the answer, in words."""
    counts = sorted({results.episodes[track.name] for track in compared(results)})
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
    (names, tracks), count = next(iter(leading.items())), len(compared(results))
    places = ", ".join(_place(results, names[0], track) for track in tracks)
    where = f"{len(tracks)} of {count} {_noun(results)}s"
    if count == 1:
        where = places
    elif len(tracks) <= min(_MOST_NAMED, count - 1):
        where += f": {places}"
    sentence = (
        f"{_listed(names)} {'is' if len(names) == 1 else 'are each'} the closest to the Nash equilibrium at the "
        f"deadline, or within {FIRST_MARGIN:g} digits of the closest, on {where}"
    )
    if (board := results.leaderboard) is not None and board.overall:
        best = board.overall[0]
        who = "it" if names == (best.policy,) else best.policy
        sentence += f"; {who} has the highest score, {Value.of(best.score, share)}"
    return f"{sentence}."


def _place(results: Results, policy: str, track: Track) -> str:
    """A track with the digits of a policy, and those of the best law that was tuned for it."""
    reached = f"{_value(results, track, policy)} digits"
    tuned = results.tuned.get(track.name, {}).get("all")
    if tuned is not None:
        reached += f"; the {tuned.name}, tuned for it: {_value(results, track, tuned.name)}"
    return f"{track.name} ({reached})"


def _others(results: Results, leading: _Leaders) -> str:
    """The entries that are first elsewhere, and how near the user's own policies come; else the next entry."""
    _, *rest = leading.items()
    clauses = []
    if rest:
        named = [
            f"{_listed([_kind(results, name) + name for name in names])} on "
            + ", ".join(_place(results, names[0], track) for track in tracks[:_MOST_NAMED])
            + f" and {len(tracks) - _MOST_NAMED} more" * (len(tracks) > _MOST_NAMED)
            for names, tracks in rest[:_MOST_NAMED]
        ]
        if left := sum(len(tracks) for _, tracks in rest[_MOST_NAMED:]):
            named.append(f"others on {left} more")
        clauses.append(f"Elsewhere the closest is {_listed(named)}")
    led = {name for names in leading for name in names}
    behind = {name: found for name in _honest(results) if name not in led and (found := _gaps(results, name))}
    own = [name for name in own_policies(results) if name in behind]
    nearest = sorted(behind, key=lambda name: min(behind[name].values()))[:1]
    for name in own or nearest * (not rest):
        track, count = min(behind[name], key=behind[name].__getitem__), len(compared(results))
        nearest_on = f"comes nearest to the closest entry on {track}," if count > 1 else "ends"
        clauses.append(f"{name} {nearest_on} {behind[name][track]:.2f} digits behind it")
    return f"{'; '.join(clauses) or 'No other honest entry was run'}."


def _kind(results: Results, policy: str) -> str:
    is_file = learned_file(results.policies[policy].training_seeds[0]) is not None
    return "the learned " if is_file else ""


def _gaps(results: Results, policy: str) -> dict[str, float]:
    """The digits by which the closest honest entry is ahead of a policy, by the tracks on which the policy acts."""
    gaps = {}
    for track in compared(results):
        reached = {name: digits for name in _honest(results) if (digits := _digits(results, track, name)) is not None}
        if policy in reached:
            gaps[track.name] = max(reached.values()) - reached[policy]
    return gaps


def _worth(results: Results) -> str:
    """The meaning of a digit, by the distance of the paper's law from the closest entry."""
    meaning = "A digit is a factor of ten in the distance of the players' estimates from the equilibrium"
    gaps = _gaps(results, LAW)
    if not gaps:
        return f"{meaning}."
    least, most = min(gaps, key=gaps.__getitem__), max(gaps, key=gaps.__getitem__)
    if gaps[most] <= FIRST_MARGIN:
        return f"{meaning}; no entry is more than {FIRST_MARGIN:g} digits ahead of the paper's law ({LAW})."
    span = (
        f"{gaps[least]:.2f} ({least}) to {gaps[most]:.2f} digits ({most})"
        if len(gaps) > 1
        else f"{gaps[most]:.2f} digits"
    )
    return f"{meaning}; the paper's law ({LAW}) ends {span} behind the closest entry."
