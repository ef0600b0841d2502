"""Certificates claim no more than is proved: on boxes, random topologies, channels, random games and other laws."""

import contextlib
import json
from dataclasses import replace

import numpy as np
import pytest
from affine_games import SOAK
from sample_laws import condition_on, spec_of

from ptne_env import CATALOGUE, FactorySpec, Interface, PolicySpec, get_scenario, laws, theory
from ptne_env.evaluation import get_policy_spec, get_suite
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import LayoutError
from ptne_env.world.graphs import cycle
from ptne_env.world.switching import fixed, markov, paper_topology, periodic, random_dwells
from ptne_env.world.world import World

LAWS = sorted(name for name, value in vars(laws).items() if isinstance(value, type) and issubclass(value, laws.Law))
LAWS.remove("Law")
WITHOUT_LOOP = {
    "CentralisedOracle",
    "ContactRelay",
    "MultiRate",
    "ObserverRelay",
    "ProjectedGradient",
    "ProximalBestResponse",
    "RoutedUnknown",
}
"""Laws that are not linear in gradient and differences, or read or remember more than these and gains."""

CYCLE = FactorySpec.of("ptne_env.world.graphs:cycle", players=5)


def channel(name, **arguments):
    return FactorySpec.of(f"ptne_env.world.channel:{name}", **arguments)


def energy_matrices(topology, kappa=2.0):
    game = World(get_scenario("energy")).game
    return [theory.closed_loop_matrix(game, graph, kappa) for graph in topology.graphs]


@pytest.mark.parametrize("law", LAWS)
def test_every_law_has_a_certificate_with_its_own_condition(law):
    certificate = theory.certify(get_scenario("energy", hold_steps=5), law=spec_of(law), delay_limit=1)
    assert certificate.condition == condition_on("energy", law)
    data = certificate.to_dict()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert (certificate.rate is None) is (law in WITHOUT_LOOP)
    assert (law in WITHOUT_LOOP) is any("no rates, digits or margins" in note for note in certificate.notes)


@pytest.mark.parametrize("name", [name for name, scenario in CATALOGUE.items() if World(scenario).game.has_bounds])
def test_a_box_takes_the_held_components_out_of_the_loop(name):
    world = World(get_scenario(name))
    game = world.game
    loop = theory.sampled_loop(world, theory.build_law(laws.Static, world))
    assert len(loop.loops[0].matrix) == game.num_players * game.dimension - game.held_at_equilibrium.sum()
    expected = theory.closed_loop_matrix(game, world.topology.graphs[0], 2.0)
    np.testing.assert_allclose(loop.loops[0].matrix, expected, atol=1e-6)
    certificate = theory.certify(world.scenario, delay_limit=0)
    assert not certificate.rate_is_exact
    assert certificate.digits_sampled is None
    assert certificate.guaranteed_rate is None


def test_noise_and_delay_of_a_channel_are_those_that_are_predicted():
    stages = (channel("AdditiveNoise", std=0.3), channel("Delay", steps=2), channel("AdditiveNoise", std=0.4))
    certificate = theory.certify(get_scenario("energy", channel=channel("Chain", stages=stages)))
    assert certificate.noise.std == pytest.approx(0.5)
    assert certificate.delay.steps == 2
    asked = theory.certify(get_scenario("energy"), noise_std=0.5, delay_steps=2)
    assert certificate.noise == asked.noise
    assert certificate.delay == replace(asked.delay, digits_are_exact=False)  # the channel has noise, too


@pytest.mark.parametrize(
    ("changes", "phrase"),
    [
        ({"channel": channel("Loss", probability=0.1)}, "no prediction includes the channel's Loss"),
        ({"channel": channel("Delay", steps=1, longest=3)}, "no prediction includes the channel's Delay"),
        ({"channel": channel("AdditiveNoise", std=0.1)}, "each on its own"),
        (
            {"disturbance": FactorySpec.of("disturbance:uniform", bound=1.0)},
            "no prediction includes the disturbance uniform",
        ),
        ({"clock_shifts": (0.0, 0.01, 0.0, 0.0, 0.0)}, "clocks disagree"),
        ({"game": FactorySpec.of("ptne_env.games:RandomEnergy", players=5), "start": "random"}, "draws games"),
    ],
)
def test_notes_name_the_faults_that_no_prediction_includes(changes, phrase):
    certificate = theory.certify(get_scenario("energy", **changes), delay_limit=0)
    assert any(phrase in note for note in certificate.notes)
    assert certificate.digits_are_exact is ("game" in changes)


def test_the_digits_of_a_late_channel_are_those_under_its_delay():
    late = channel("Delay", steps=2)
    certificate = theory.certify(get_scenario("energy", channel=late))
    assert not certificate.digits_are_exact
    assert certificate.delay.digits_are_exact
    assert certificate.delay.digits == theory.certify(get_scenario("energy"), delay_steps=2).delay.digits


@pytest.mark.parametrize("clock", ["physical", "transformed"])
def test_a_random_topology_gets_estimates_with_a_note(clock):
    graphs = (CYCLE, FactorySpec.of("ptne_env.world.graphs:path", players=5))
    dwells = (0.1, 0.2) if clock == "physical" else (0.3, 0.5)
    spec = FactorySpec.of("ptne_env.world.switching:random_dwells", graphs=graphs, dwells=dwells, clock=clock)
    certificate = theory.certify(get_scenario("energy", topology=spec), delay_limit=0)
    assert not certificate.rate_is_exact
    assert any("the topology is random" in note for note in certificate.notes)
    slowest = min(map(theory.spectral_abscissa, energy_matrices(spec.build())))
    assert certificate.rate == pytest.approx(slowest) if clock == "physical" else certificate.rate > slowest
    assert certificate.digits_sampled > 2


@pytest.mark.parametrize(
    ("law", "clock", "phrase"),
    [
        ("Static", "physical", "the smallest over the modes, as any of them may be the last"),
        ("Static", "transformed", "estimated from one draw of 2000 dwells"),
        ("CorollaryOne", "physical", "estimated from one draw of 2000 dwells"),
        ("CorollaryOne", "transformed", None),
    ],
)
def test_the_note_on_a_random_topology_says_where_the_rate_comes_from(law, clock, phrase):
    graphs = (CYCLE, FactorySpec.of("ptne_env.world.graphs:path", players=5))
    spec = FactorySpec.of("ptne_env.world.switching:random_dwells", graphs=graphs, dwells=(0.1, 0.3), clock=clock)
    notes = theory.certify(get_scenario("energy", topology=spec), law=spec_of(law), delay_limit=0).notes
    found = [note for note in notes if note.startswith("the rate is")]
    assert (not found) if phrase is None else phrase in found[0]


@pytest.mark.parametrize("law", ["Static", "CorollaryOne"])
def test_a_graph_that_an_episode_draws_has_the_rate_of_the_slowest(law):
    spec = FactorySpec.of("ptne_env.world.switching:random_graphs", players=5, probability=0.6, modes=4, seed=1)
    certificate = theory.certify(get_scenario("energy", topology=spec), law=spec_of(law), delay_limit=0)
    slowest = min(map(theory.spectral_abscissa, energy_matrices(spec.build(), certificate.kappa)))
    assert certificate.rate == pytest.approx(slowest)
    assert not any("the topology switches" in note for note in certificate.notes)
    assert any("of which an episode draws one" in note for note in certificate.notes)


def test_rates_of_random_topologies_agree_with_those_of_certain_ones():
    certain = paper_topology(0.25, "transformed")
    drawn = random_dwells(certain.graphs, 0.25, "transformed")
    matrices = energy_matrices(certain)
    expected = theory.decay_rate(matrices, certain, 1.2)
    assert theory.decay_rate(matrices, drawn, 1.2) == pytest.approx(expected, rel=0.05)
    one = markov([cycle(5), cycle(5)], [[0.5, 0.5], [0.5, 0.5]], (0.1, 0.4), "transformed")
    assert theory.decay_rate(energy_matrices(one), one, 1.2) == pytest.approx(
        theory.decay_rate(energy_matrices(one)[:1], fixed(cycle(5)), 1.2), rel=0.05
    )


def test_a_law_without_the_time_gain_has_the_rate_of_the_mean_graph_in_s():
    graphs = paper_topology().graphs
    even = [[0.25] * 4] * 4
    in_s = markov(graphs, even, 0.25, "transformed")
    matrices = energy_matrices(in_s)
    expected = theory.spectral_abscissa(np.mean(matrices, axis=0))
    assert theory.decay_rate_in_time(matrices, in_s) == pytest.approx(expected)
    uneven = periodic(graphs, [0.1, 0.2, 0.3, 0.4], "transformed")
    expected = theory.spectral_abscissa(np.average(matrices, axis=0, weights=[0.1, 0.2, 0.3, 0.4]))
    assert theory.decay_rate_in_time(matrices, uneven) == pytest.approx(expected)


@pytest.mark.parametrize("scenario", ["enrgy", None, World(get_scenario("energy"))])
def test_a_certificate_needs_a_scenario(scenario):
    with pytest.raises(TypeError, match="certify needs a Scenario, got the (str 'enrgy'|NoneType|World).*get_scenario"):
        theory.certify(scenario)


@pytest.mark.parametrize(
    "law",
    [
        laws.Grounded,
        laws.Grounded(make_encoder(World(get_scenario("energy")), Interface("physical")).layout),
        lambda layout: laws.Grounded(layout, kappa=2.0),
        "Grounded",
        "ptne_env.laws:Grounded",
        PolicySpec("mine", laws.Grounded),
        get_policy_spec("grounded"),
    ],
    ids=["class", "law", "function", "name", "address", "PolicySpec", "policy of a name"],
)
def test_a_law_is_given_by_class_object_name_or_policy(law, energy_grounded):
    found = theory.certify(get_scenario("energy"), law=law, delay_limit=0)
    assert replace(found, law="") == replace(energy_grounded, law="")


@pytest.fixture(scope="module")
def energy_grounded():
    return theory.certify(get_scenario("energy"), law=spec_of("Grounded"), delay_limit=0)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"law": "gruonded"}, ValueError, r"unknown law 'gruonded'; did you mean 'Grounded'.*get_policy_spec\("),
        ({"law": 5}, TypeError, "law is a class, function, law, name, FactorySpec or PolicySpec of one policy, got 5"),
        (
            {"law": laws.Static(make_encoder(World(get_scenario("oligopoly")), Interface("physical")).layout)},
            ValueError,
            "layout",
        ),
        ({"kappa": laws.Static}, TypeError, "the second argument of certify is the number kappa.*write law="),
    ],
)
def test_something_else_in_the_place_of_a_law_is_refused_with_advice(arguments, error, message):
    with pytest.raises(error, match=message):
        theory.certify(get_scenario("energy"), **arguments)


def test_only_steps_below_the_largest_stable_step_have_exact_digits():
    short, long = (theory.certify(get_scenario("energy", steps=steps), delay_limit=0) for steps in (140, 130))
    assert long.step_margin < 1 < short.step_margin
    assert (short.digits_are_exact, long.digits_are_exact) == (True, False)
    assert [any("amplifies errors" in note for note in each.notes) for each in (short, long)] == [False, True]


@pytest.mark.parametrize(("steps", "exact"), [(400, True), (140, False)])
def test_only_delays_that_leave_the_loop_stable_have_exact_digits(steps, exact):
    certificate = theory.certify(get_scenario("energy", steps=steps), delay_steps=2)
    assert certificate.digits_are_exact
    assert (certificate.delay.for_every_delay or certificate.delay.margin >= 2) is exact
    assert certificate.delay.digits_are_exact is exact


def test_an_input_above_the_limit_has_no_exact_digits():
    certificate = theory.certify(get_scenario("energy", input_limit=10.0), delay_limit=0)
    assert not certificate.digits_are_exact
    assert any("above the input limit" in note for note in certificate.notes)


def test_a_law_that_never_moves_has_exact_digits():
    certificate = theory.certify(get_scenario("energy"), law=spec_of("ZeroInput"), delay_limit=0)
    assert certificate.step_margin is None
    assert certificate.digits_are_exact


def test_the_worst_start_is_that_of_the_deadline_and_not_of_the_hold_phase():
    gained = [
        theory.certify(get_scenario("energy", hold_steps=steps), delay_limit=0).worst_digits_gained for steps in (0, 50)
    ]
    assert gained[0] == gained[1]


def test_a_certificate_of_many_estimates_names_what_it_leaves_out(monkeypatch):
    full = theory.certify(get_scenario("energy"), delay_limit=0)
    monkeypatch.setattr("ptne_env.theory.sampled.LARGEST_PRODUCT", 24)
    certificate = theory.certify(get_scenario("energy"), delay_limit=0)
    assert (certificate.noise, certificate.worst_digits_gained, certificate.sampled_rate) == (None, None, None)
    assert (certificate.rate, certificate.digits_sampled) == (full.rate, full.digits_sampled)
    (note,) = [note for note in certificate.notes if "left out" in note]
    assert "the rate of the sampled loop, the worst start and noise" in note


@pytest.mark.skipif(not SOAK, reason="takes half a minute; PTNE_SOAK=1 runs it")
def test_every_law_has_a_certificate_on_every_track():
    for track in get_suite("ptne-v1").tracks:
        if not track.name.startswith("large"):
            for law in LAWS:
                with contextlib.suppress(LayoutError):  # the law cannot act on the track
                    theory.certify(track.scenario, law=spec_of(law), delay_limit=1)


@pytest.mark.skipif(not SOAK, reason="takes 20 seconds; PTNE_SOAK=1 runs it")
def test_the_largest_track_has_a_certificate():
    certificate = theory.certify(get_suite("ptne-v1").track("large-50").scenario)
    assert certificate.rate > 0
    assert certificate.digits_are_exact


@pytest.mark.parametrize("law", ["Adaptive", "AdaptiveGrounded"])
def test_gains_that_adapt_are_listed_at_start_and_deadline(law):
    certificate = theory.certify(get_scenario("energy"), law=spec_of(law), delay_limit=0)
    start, end = certificate.frozen_gains
    assert (start.instant, end.instant) == ("start", "deadline")
    assert start.smallest == start.largest <= end.smallest <= end.largest
    assert certificate.rate == end.rate
    assert certificate.worst_digits_gained is None


def test_a_law_without_rows_of_noise_and_delay_says_that_no_number_includes_them():
    noise = get_suite("ptne-v1").track("noise").scenario
    missing, rows = "no prediction includes noise of messages", "only the rows of noise and delay include"
    notes = {law: " ".join(theory.certify(noise, law=spec_of(law)).notes) for law in ("ObserverRelay", "Static")}
    assert missing in notes["ObserverRelay"]
    assert rows not in notes["ObserverRelay"]
    assert missing not in notes["Static"]
    assert rows in notes["Static"]
    asked = theory.certify(get_scenario("energy"), law=spec_of("ObserverRelay"), noise_std=0.1, delay_steps=1)
    assert "no prediction includes noise and delay of messages" in asked.notes
