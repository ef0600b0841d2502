"""The answer of a comparison: three sentences and one table, which follow from the results."""

from dataclasses import replace

import pytest

from ptne_env import FactorySpec, PolicySpec, evaluate, get_scenario
from ptne_env.bench.report.answer import SPECIALIST, TUNED, answer, answer_table, leaders, own_policies
from ptne_env.evaluation import Suite, Track, get_policy_spec, run_suite
from ptne_env.perception.observation import Interface


def digits_of(results, track, policy):
    record = results.record(track, policy, "digits")
    return f"{record['mean']:.2f} ±{record['high'] - record['mean']:.2f}"


@pytest.fixture(scope="module")
def switching():
    """A law that plays two worlds, and a learned policy that is closer in the one that it plays."""
    worlds = [get_scenario(name, hold_steps=0) for name in ("random-energy", "random-energy-switching")]
    tracks = [Track(world.name, world, f"The world {world.name}.") for world in worlds]
    suite = Suite("pair", tuple(tracks), episodes=8, is_comparison=True)
    learned = replace(get_policy_spec("ppo-random-energy-switching"), scenarios=frozenset({"random-energy-switching"}))
    return run_suite(suite, ["grounded", "static", learned])


def test_the_answer_names_every_entry_where_it_is_the_closest(switching):
    first, others, worth = answer(switching)
    assert first == (
        "grounded is the closest to the Nash equilibrium at the deadline, up to 0.1 digits and the 95 % interval, on "
        f"1 of 2 scenarios: random-energy ({digits_of(switching, 'random-energy', 'grounded')} digits)."
    )
    reached = digits_of(switching, "random-energy-switching", "ppo-random-energy-switching")
    assert others == (
        "Elsewhere the closest is the learned ppo-random-energy-switching on random-energy-switching "
        f"({reached} digits)."
    )
    gaps = [
        switching.record(track, best, "digits")["mean"] - switching.record(track, "static", "digits")["mean"]
        for track, best in (
            ("random-energy-switching", "ppo-random-energy-switching"),
            ("random-energy", "grounded"),
        )
    ]
    assert worth == (
        "A digit is a factor of ten in the distance of the players' estimates from the equilibrium; the paper's law "
        f"(static) ends {gaps[0]:.2f} (random-energy-switching) to {gaps[1]:.2f} digits (random-energy) behind the "
        "closest."
    )


def test_the_table_has_a_row_per_scenario_and_the_leaders_first(switching, comparison):
    table = answer_table(switching)
    assert list(table.rows) == ["random-energy", "random-energy-switching"]
    assert [column.label for column in table.columns] == ["grounded", "static", SPECIALIST]
    specialist = table.columns[-1]
    assert specialist["random-energy"].value is None
    assert str(specialist["random-energy-switching"]) == digits_of(
        switching, "random-energy-switching", "ppo-random-energy-switching"
    )
    assert [column.label for column in answer_table(comparison).columns][-1] == "oracle"


def test_the_users_own_policy_is_named_where_it_comes_nearest(comparison, hostile):
    assert own_policies(comparison) == [hostile]
    gap = {
        track: comparison.record(track, "grounded", "digits")["mean"]
        - comparison.record(track, hostile, "digits")["mean"]
        for track in ("energy", "energy-switching")
    }
    nearest = min(gap, key=gap.get)
    assert answer(comparison)[1] == (
        f"{hostile} comes nearest to the closest on {nearest}, {gap[nearest]:.2f} digits behind it."
    )


@pytest.mark.parametrize(
    ("names", "parts"),
    [
        (["static", "zero-input"], ["static is the closest", "zero-input ends ", "nothing is clearly ahead of "]),
        (["zero-input"], ["zero-input is the closest", "No other honest entry was run.", "A digit is"]),
        (["oracle"], ["No honest entry was run: coded entries stand apart"]),
        (["adaptive", "zero-input"], ["adaptive is the closest", "zero-input ends ", "A digit is"]),
    ],
)
def test_the_answer_of_few_policies(names, parts):
    sentences = answer(evaluate(names, ["energy"], episodes=3))
    assert len(sentences) == len(parts)
    for sentence, part in zip(sentences, parts, strict=True):
        assert part in sentence


def test_coded_entries_do_not_lead():
    coded = PolicySpec("code", FactorySpec.of("ptne_env.laws:Grounded"), Interface(estimates="coded"))
    results = evaluate([coded, "static"], ["energy"], episodes=2, against_laws=False)
    assert list(leaders(results)) == [("static",)]


def test_the_answer_names_every_policy_that_shares_the_first_place():
    again = replace(get_policy_spec("grounded"), name="again")
    first, *_ = answer(evaluate(["grounded", again, "static"], ["energy"], episodes=2))
    assert first.startswith("grounded and again are each the closest to the Nash equilibrium")
    assert first.endswith("on energy (12.00 digits).")


def test_the_answer_of_a_suite_names_the_highest_score(suite):
    best = suite.leaderboard.overall[0]
    assert answer(suite)[0].startswith(f"{best.policy} is the closest")
    assert f"; it has the highest score, {best.score.mean:.3f} [" in answer(suite)[0]


def test_the_answer_compares_a_leading_learned_policy_with_the_tuned_law():
    learned = replace(get_policy_spec("ppo-random-energy"), scenarios=frozenset({"random-energy"}))
    results = evaluate([learned, "static"], ["random-energy", "robots"], episodes=4, against_laws=True)
    tuned = results.record("random-energy", "best of all laws", "digits")
    half = tuned["high"] - tuned["mean"]
    expected = f"{tuned['mean']:.2f}" + f" ±{half:.2f}" * (half >= 0.005)
    assert any(f"; the best of all laws, tuned for it: {expected})" in sentence for sentence in answer(results))


def test_the_answer_names_the_tuned_law_where_it_is_closer_than_every_entry():
    learned = replace(get_policy_spec("ppo-random-energy-switching"), scenarios=None)
    names = ["energy", "random-energy-switching"]
    results = evaluate([learned, "grounded"], names, episodes=8, against_laws=True)
    (entries, tracks), (tuned, beaten) = leaders(results).items()
    assert (entries, [track.name for track in tracks]) == (("grounded",), names[:1])
    assert (tuned, [track.name for track in beaten]) == ((TUNED,), names[1:])
    first, others, _ = answer(results)
    assert "grounded is the closest" in first
    assert "on 1 of 2 scenarios" in first
    law, entry = (digits_of(results, names[1], name) for name in (TUNED, learned.name))
    assert others.startswith(
        "Elsewhere the closest is a law that is tuned for the scenario on random-energy-switching "
        f"({law} digits; {learned.name}: {entry})"
    )
    assert [column.label for column in answer_table(results).columns][:2] == ["grounded", TUNED]
    alone, *_ = answer(evaluate([learned], names[1:], episodes=8, against_laws=True))
    assert alone.startswith("A law that is tuned for the scenario is the closest to the Nash equilibrium")
