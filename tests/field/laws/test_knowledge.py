"""Relays with less and with more knowledge, and the indicator of honest estimates."""

import dataclasses

import numpy as np
import pytest
from worlds import world_and_encoder

from ptne_env import FactorySpec, PolicySpec, laws
from ptne_env.evaluation import POLICIES, Suite, get_suite, run_suite
from ptne_env.field import laws as field_laws
from ptne_env.field.laws.relay import contacts
from ptne_env.field.laws.routed import nearer_slots
from ptne_env.perception.observation import Interface, LayoutError
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import dynamics

RELAYS = ("link-relay", "contact-relay", "route-relay", "observer-relay", "freshest-relay")
CODED_LINKS = PolicySpec("link-broadcast", FactorySpec.of("ptne_env.field.laws:LinkBroadcast"))
LAWS = (*RELAYS, CODED_LINKS)
V1 = get_suite("ptne-v1")


def results(policies, *tracks, episodes=6, **changes):
    """Of policies on tracks of ptne-v1 with changed scenarios; every decision is audited."""
    chosen = [V1.track(name) for name in tracks]
    changed = tuple(dataclasses.replace(track, scenario=track.scenario.replace(**changes)) for track in chosen)
    found = run_suite(Suite("knowledge", changed, episodes, is_comparison=True), policies)
    assert not found.failures
    metrics = ("digits", "unexplained_share", "diverged_share")
    return {place: {name: float(np.mean(of[name])) for name in metrics} for place, of in found.samples.items()}


def one_contact(mine, theirs, votes=0.0, nearer=None, seen=0.0, news=1.0, noise=0.0, lasts=False):
    """Whether the neighbour becomes the source at the start of a contact, or later; moves since the last one."""
    observation = Sight(
        np.array([[[theirs - mine + (seen if np.isfinite(seen) else 0.0)]]]), np.ones((1, 1)), np.ones((1, 1))
    )
    drift, memory = np.zeros((1, 1)), {"live": np.full((1, 1), float(lasts)), "heard": np.ones((1, 1))}
    memory |= {"steps": np.ones((1, 1)), "news": np.full((1, 1), news), "source": np.zeros((1, 1, 1))}
    memory |= {"moved": np.full((1, 1, 1), mine), "seen": np.full((1, 1, 1), seen), "votes": np.full((1, 1, 1), votes)}
    no_owner = np.zeros((1, 1, 1), dtype=bool)
    known = None if nearer is None else np.full((1, 1, 1), nearer)
    sources, fresh = contacts(observation, memory, drift, no_owner, known, np.full((1, 1, 1), noise))
    return sources.item(), fresh["votes"].item()


def second_neighbour_wakes(before, after, source):
    """Whether a neighbour at two distances becomes the source during a contact, beside another one that rests."""
    ones, shape = np.ones((1, 2)), (1, 2, 1)
    memory = {"live": ones, "heard": ones, "steps": np.ones((1, 1)), "news": np.ones((1, 1))}
    memory |= {"moved": np.zeros(shape), "votes": np.zeros(shape)}
    memory |= {"seen": np.reshape([0.0, before], shape), "source": np.reshape([source, 0.0], shape)}
    sight = Sight(np.reshape([0.0, after], shape), ones, np.ones((1, 1)))
    found, _ = contacts(sight, memory, np.zeros((1, 1)), np.zeros(shape, dtype=bool))
    return bool(found[0, 1, 0])


@dataclasses.dataclass
class Sight:
    relative_estimates: np.ndarray
    weights: np.ndarray
    unit: np.ndarray


def test_a_copy_that_moved_alone_is_the_fresher_one_and_gets_a_vote():
    assert one_contact(0.0, 1.0) == (True, 1)
    assert one_contact(1.0, 0.0) == (False, -1)
    assert one_contact(0.0, 0.0, seen=2.0) == (False, 0)


def test_votes_decide_between_two_copies_that_moved_and_then_the_longer_move():
    assert one_contact(1.0, 2.0) == (True, 0)
    assert one_contact(2.0, 1.0) == (False, 0)
    assert one_contact(1.0, 2.0, votes=-1) == (False, -1)
    assert one_contact(2.0, 1.0, votes=1) == (True, 1)


def test_known_hop_counts_overrule_votes():
    assert one_contact(2.0, 1.0, votes=-3, nearer=1) == (True, -3)
    assert one_contact(2.0, 1.0, votes=3, nearer=-1) == (True, 3)  # no nearer neighbour was heard


def test_a_player_without_news_takes_the_copy_of_a_new_neighbour():
    assert one_contact(0.0, 0.0, seen=np.inf, news=0.0) == (True, 0)
    assert one_contact(0.0, 0.0, seen=np.inf, news=1.0) == (False, 0)


def test_during_a_contact_only_a_move_beyond_noise_is_news():
    assert one_contact(0.0, 1.0, lasts=True) == (True, 0)
    assert one_contact(0.0, 1.0, noise=0.9, lasts=True) == (True, 0)
    assert one_contact(0.0, 1.0, noise=1.1, lasts=True) == (False, 0)


def test_a_neighbour_on_its_way_to_the_own_copy_does_not_replace_a_source():
    assert second_neighbour_wakes(0.0, 1.0, source=1.0)
    assert not second_neighbour_wakes(1.0, 0.5, source=1.0)
    assert second_neighbour_wakes(1.0, 0.5, source=0.0)


@pytest.mark.parametrize(("name", "digits"), [("one-way", 4.7), ("unseen", 4.8), ("tight-input", 4.4), ("uneven", 4.4)])
def test_contacts_show_the_sources_in_spite_of_noise(name, digits):
    track = dataclasses.replace(get_suite("ptne-v2").track(name), best_known=None)
    found = run_suite(Suite("noisy", (track,), 12, is_comparison=True), ["contact-relay"])
    assert found.samples[name, "contact-relay"]["digits"].mean() > digits


def test_players_of_own_links_find_the_nearer_neighbours_of_a_fixed_graph():
    scenario = V1.track("large-20").scenario
    nearer = nearer_slots(world_and_encoder(scenario, graph_knowledge="union")[1].layout)
    world, encoder = world_and_encoder(scenario)
    law, memory = field_laws.ContactRelay(encoder.layout), None
    state = dynamics.draw_initial_state(world, [RandomStreams.from_seed(0)])
    for _ in range(12):
        actions, memory = law.predict(encoder.observe(state)[0], state=memory)
        state = dynamics.step(world, state, encoder.decode(actions[None], state))
    of_others = ~encoder.layout.own_mask[:, None]
    np.testing.assert_array_equal((law._parts.split(memory)["source"] > 0) & of_others, nearer)


@pytest.mark.parametrize("track", ["switching-physical", "robots", "mixed-team"])
def test_every_law_decides_row_by_row_from_what_its_players_know(track):
    found = results(LAWS, track, episodes=3, steps=120)
    assert len(found) == len(LAWS)
    assert max(metrics["diverged_share"] for metrics in found.values()) == 0


def test_digits_by_knowledge_on_switching_graphs():
    found = results(LAWS, "switching-physical", episodes=10)
    digits = {name: metrics["digits"] for (_, name), metrics in found.items()}
    assert digits["link-broadcast"] > 11.9
    assert digits["freshest-relay"] > 4.4 > digits["link-relay"] > 3.8
    assert digits["contact-relay"] > 3.2


def test_memory_of_own_links_is_worth_more_than_the_union_of_drawn_graphs():
    found = results(["contact-relay", "relay"], "unseen-graphs", episodes=20, steps=40)
    assert found["unseen-graphs", "contact-relay"]["digits"] > found["unseen-graphs", "relay"]["digits"] + 5


def test_relays_of_chosen_sources_average_noise_like_relay():
    found = results(["freshest-relay", "relay"], "noise", episodes=10)
    assert found["noise", "freshest-relay"]["digits"] == pytest.approx(found["noise", "relay"]["digits"], abs=0.01)


def test_hop_counts_are_worth_nothing_where_every_episode_draws_its_graph():
    found = results(["contact-relay", "route-relay"], "unseen-graphs", episodes=6, steps=40)
    digits = [metrics["digits"] for metrics in found.values()]
    assert digits == pytest.approx([digits[0]] * 2, abs=1.0)


@pytest.mark.parametrize(("name", "knowledge_of"), [("RouteRelay", "union"), ("FreshestRelay", "schedule")])
def test_knowledge_that_a_layout_lacks_is_refused(name, knowledge_of):
    layout = world_and_encoder("energy-switching")[1].layout
    with pytest.raises(LayoutError, match=f"declare graph_knowledge='{knowledge_of}'"):
        getattr(laws, name)(layout)


HONEST = ("static", "grounded", "routed", "routed-unknown", "relay", "freshest")


@pytest.mark.parametrize("track", ["switching-physical", "noise", "delay"])
def test_estimates_of_honest_laws_move_between_estimates_at_hand(track):
    found = results([POLICIES[name] for name in HONEST], track, episodes=3)
    assert max(metrics["unexplained_share"] for metrics in found.values()) < 1e-4


def test_estimates_of_coded_laws_move_beyond_all_estimates_at_hand():
    coded = [policy for policy in POLICIES.values() if policy.interface.estimates == "coded"]
    assert {policy.name for policy in coded} == {"identify-and-broadcast", "aggregate-tracking"}
    found = results([*coded, CODED_LINKS], "switching-physical", episodes=3)
    # The laws of the broadcast send code during nine tenths of the episode.
    assert found["switching-physical", "identify-and-broadcast"]["unexplained_share"] > 0.7
    assert found["switching-physical", "link-broadcast"]["unexplained_share"] > 0.7
    assert found["switching-physical", "aggregate-tracking"]["unexplained_share"] > 0.3
    assert Interface().estimates == "honest"


def test_unexplained_share_of_an_episode_without_moves_has_no_value():
    found = run_suite(Suite("rest", (V1.track("nominal"),), 2, is_comparison=True), ["zero-input"])
    assert np.isnan(found.samples["nominal", "zero-input"]["unexplained_share"]).all()
