"""Channels: what each stage does to messages, statistics, and information hidden from receivers.

Statistical tests have a false-alarm probability of at most ``FALSE_ALARM`` per comparison; seeds are fixed.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from worlds import BLOCKS_SWITCHING, EVERY_FAULT, FAULTY, begin, channel_part, quantity

from ptne_env import FactorySpec, get_scenario
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.observation import Interface
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import dynamics
from ptne_env.world.channels import Chain, Channel, LinkRandomness, Lying, Messages
from ptne_env.world.world import World

FALSE_ALARM = 1e-6

SWITCHING = get_scenario("random-energy-switching-transformed", gain=2.0, steps=60, hold_steps=3)
FIXED = get_scenario("random-energy", steps=60, hold_steps=3)

STAGES = {
    "additive noise": channel_part("AdditiveNoise", std=0.3),
    "constant delay": channel_part("Delay", steps=2),
    "zero delay": channel_part("Delay", steps=0),
    "random delay": channel_part("Delay", steps=1, longest=5),
    "loss": channel_part("Loss", probability=0.4),
    "bursts": channel_part("BurstLoss", to_bad=0.1, to_good=0.4),
    "uniform levels": channel_part("UniformQuantiser", width=0.25),
    "range": channel_part("Range", limit=2.0),
    "lies": channel_part("Lying", size=3.0),
    "bias": channel_part("Bias", bound=0.1),
    "heavy tails": channel_part("HeavyTails", scale=0.5),
    "late noise": channel_part("LateNoise", std=0.5, step=2),
}
CHANNELS = STAGES | {"everything": EVERY_FAULT, "nothing": channel_part("Chain", stages=())}


def wandering(scenario, batch, steps=None, seed=0):
    """States of an episode under random inputs."""
    world = World(scenario)
    generator = np.random.default_rng(seed)
    states = [begin(world, range(batch))]
    for _ in range(steps or world.clock.total_steps):
        inputs = generator.normal(size=(*states[0].estimates.shape[:2], 1)) * 20
        states.append(dynamics.step(world, states[-1], np.tile(inputs, (1, 1, batch))))
    return world, states


RECEIVED = ("weights", "relative_estimates", "messages", "active_mode", "time_since_switch", "estimates")


def column(array, b, batch):
    return array[..., b : b + 1] if array.shape[-1] == batch else array


def test_batch_equals_single_environments_through_restarts():
    world, batch = World(FAULTY), 5
    together, alone = begin(world, range(batch)), [begin(world, [b]) for b in range(batch)]
    generator = np.random.default_rng(0)
    for k in range(50):
        if k in (20, 33):  # some environments restart
            mask = np.arange(batch) % 2 == k % 2
            seeds = [100 * k + b for b in np.flatnonzero(mask)]
            together = dynamics.merge(together, begin(world, seeds), mask)
            for b, seed in zip(np.flatnonzero(mask), seeds, strict=True):
                alone[b] = begin(world, [seed])
        inputs = generator.normal(size=together.estimates.shape)
        together = dynamics.step(world, together, inputs)
        for b in range(batch):
            alone[b] = dynamics.step(world, alone[b], inputs[:, :, b : b + 1])
            for field in RECEIVED:
                whole, single = quantity(world, together, field), quantity(world, alone[b], field)
                assert np.array_equal(column(whole, b, batch), single), field


def noise_of(seed, inputs_seed, scenario):
    """The noise of each message, per step, under inputs of another seed."""
    world = World(scenario)
    generator, state, result = np.random.default_rng(inputs_seed), begin(world, [seed]), []
    for _ in range(10):
        result.append(state.received.messages - dynamics.sent_messages(world, state.estimates))
        state = dynamics.step(world, state, generator.normal(size=state.estimates.shape))
    return np.array(result)


def test_noise_depends_on_the_seed_and_not_on_the_policy():
    scenario = FIXED.replace(channel=STAGES["additive noise"])
    first = noise_of(3, 0, scenario)
    assert noise_of(3, 0, scenario).tolist() == first.tolist()
    assert noise_of(3, 1, scenario) == pytest.approx(first, abs=1e-12)
    assert np.abs(noise_of(4, 0, scenario) - first).max() > 0.1


def test_padded_slots_do_not_change_the_noise_of_a_link():
    noisy = FIXED.replace(channel=STAGES["additive noise"])
    plain, world = begin(World(noisy), [1]), World(noisy.replace(slots=4))
    padded = begin(world, [1])
    assert np.array_equal(padded.received.messages[:2], plain.received.messages)
    assert not dynamics.relative_estimates(world, padded)[2:].any()
    assert not padded.received.weights[2:].any()


def test_stages_of_a_chain_draw_independently():
    noise = STAGES["additive noise"]
    scenario = FIXED.replace(channel=channel_part("Chain", stages=(noise,) * 2), steps=400)
    one = FIXED.replace(channel=channel_part("Chain", stages=(noise,)), steps=400)
    both, first = (np.concatenate([noise_of(seed, 0, each) for seed in range(20)]).ravel() for each in (scenario, one))
    second = both - first
    limit = stats.norm.isf(FALSE_ALARM / 2) / math.sqrt(second.size)
    assert abs(np.corrcoef(first, second)[0, 1]) < limit
    assert stats.kstest(second / 0.3, "norm").pvalue > FALSE_ALARM


def test_perfect_channel_has_no_messages_and_no_draws():
    for scenario in (FIXED, SWITCHING):
        world, states = wandering(scenario, 2, steps=20)
        assert world.channel.is_perfect
        for state in states:
            assert state.received is None
            assert state.randomness is None
    chained = FIXED.replace(channel=channel_part("Chain", stages=(channel_part("Chain", stages=()),)))
    assert World(chained).channel.is_perfect


def test_zero_faults_are_the_perfect_channel():
    none = channel_part(
        "Chain",
        stages=(
            channel_part("AdditiveNoise", std=0.0),
            channel_part("Delay", steps=0),
            channel_part("Loss", probability=0.0),
        ),
    )
    for interface in ("physical", "scaled"):
        plain, faulty = (World(SWITCHING.replace(channel=channel)) for channel in ("perfect", none))
        encoders = [Encoder(world, Interface(interface)) for world in (plain, faulty)]
        states = [begin(world, range(3)) for world in (plain, faulty)]
        for _ in range(40):
            observations = [encoder.observe(state) for encoder, state in zip(encoders, states, strict=True)]
            assert np.array_equal(*observations)
            actions = np.random.default_rng(0).uniform(-1, 1, (3, 5, 5)).astype(np.float32)
            inputs = [encoder.decode(actions, state) for encoder, state in zip(encoders, states, strict=True)]
            states = [dynamics.step(plain, states[0], inputs[0]), dynamics.step(faulty, states[1], inputs[1])]


def test_messages_are_clipped_to_the_range():
    world, states = wandering(FIXED.replace(message_range=4.0), 3, steps=20)
    for state in states:
        sent = dynamics.sent_messages(world, state.estimates)
        assert (np.abs(sent) > 4.0).any()
        assert np.array_equal(state.received.messages, np.clip(sent, -4.0, 4.0))


def test_noise_comes_after_the_range_and_players_know_it():
    noisy = FIXED.replace(channel=STAGES["additive noise"], message_range=4.0)
    world = World(noisy)
    state = begin(world, range(50))
    sent = dynamics.sent_messages(world, state.estimates)
    noise = state.received.messages - np.clip(sent, -4.0, 4.0)
    assert stats.kstest(noise.ravel() / 0.3, "norm").pvalue > FALSE_ALARM
    assert np.abs(state.received.messages).max() > 4.5
    for kind in ("physical", "scaled", "full"):
        assert Encoder(world, Interface(kind)).layout.message_range == 4.0
        assert Encoder(World(FIXED), Interface(kind)).layout.message_range == math.inf
    assert World(FIXED).channel.is_perfect


@pytest.mark.parametrize("scenario", [FIXED, BLOCKS_SWITCHING])
def test_one_player_lies_about_components_of_others_alone(scenario):
    world = World(scenario.replace(channel=channel_part("Lying", size=3.0)))
    states = [begin(world, range(30))]
    for _ in range(4):
        states.append(dynamics.step(world, states[-1], np.ones_like(states[-1].estimates)))
    liars, told = set(), []
    for b in range(30):
        found = {}
        for state in states:
            lies = state.received.messages[..., b] - dynamics.sent_messages(world, state.estimates)[..., b]
            for slot, component, receiver in np.argwhere(np.abs(lies) > 1e-9).tolist():
                sender = int(world.neighbours[slot, receiver])
                assert world.game.owners[component] != sender
                found.setdefault((sender, component), []).append(lies[slot, component, receiver])
        assert len({sender for sender, _ in found}) == 1
        liars |= {sender for sender, _ in found}
        (liar,) = {sender for sender, _ in found}
        assert len(found) == world.game.dimension - world.game.action_dims[liar]
        for values in found.values():  # the same for every neighbour and in every step
            assert np.ptp(values) < 1e-9
            told.append(values[0])
    assert liars == set(range(world.game.num_players))
    assert 2.5 < np.abs(told).max() < 3
    assert stats.kstest(told, stats.uniform(-3, 6).cdf).pvalue > FALSE_ALARM


def test_the_offset_of_a_liar_does_not_depend_on_who_lies():
    batch = 4000
    keys = np.random.default_rng(0).integers(0, 2**64, batch, dtype=np.uint64)
    sent = constant_messages(batch, value=0.0)
    randomness = LinkRandomness(keys, np.zeros(batch, dtype=np.int64), SENDERS, np.arange(5))
    received, _ = Lying(3.0).transmit(sent, None, randomness)
    offsets = received.values.sum(axis=(0, 2)) / 2  # each player sends to two neighbours
    liars = np.argmin(np.abs(offsets), axis=0)  # the own component is not changed
    for component in range(5):
        others = liars != component
        assert stats.pearsonr(liars[others], offsets[component, others]).pvalue > FALSE_ALARM


def constant_messages(batch=400, slots=2, dimension=5, players=5, value=3.0):
    live = np.ones((slots, players, batch), dtype=bool)
    return Messages(np.full((slots, dimension, players, batch), value), live, live.astype(float))


SENDERS = np.array([[1, 2, 3, 4, 0], [4, 0, 1, 2, 3]])


def transmit(channel, steps, messages=None, batch=400, seed=0):
    """The output of each step for the input ``messages(k)``."""
    keys = np.random.default_rng(seed).integers(0, 2**64, batch, dtype=np.uint64)
    memory, results = None, []
    for k in range(steps):
        sent = constant_messages(batch) if messages is None else messages(k)
        randomness = LinkRandomness(keys, np.full(batch, k), SENDERS, np.arange(5))
        before = sent.values.copy()
        out, memory = channel.transmit(sent, memory, randomness)
        assert np.array_equal(sent.values, before)
        results.append(out)
    return results


def build(name):
    return CHANNELS[name].build()


def errors(name, steps):
    """What the channel adds to each message, per step."""
    return np.array([out.values - 3.0 for out in transmit(build(name), steps)])


def test_noise_is_normal_with_its_standard_deviation():
    noise = errors("additive noise", 10)
    assert stats.kstest(noise.ravel() / 0.3, "norm").pvalue > FALSE_ALARM
    for axis in range(5):  # neighbours along steps, slots, components, players and episodes are uncorrelated
        first, second = np.delete(noise, 0, axis), np.delete(noise, -1, axis)
        limit = stats.norm.isf(FALSE_ALARM / 2) / math.sqrt(first.size)
        assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < limit


def test_a_bias_is_uniform_over_links_and_components_and_the_same_in_all_steps():
    offsets = errors("bias", 3)
    np.testing.assert_array_equal(offsets[1:], offsets[:1].repeat(2, axis=0))
    assert stats.kstest(offsets[0].ravel(), stats.uniform(-0.1, 0.2).cdf).pvalue > FALSE_ALARM


def test_heavy_tails_are_those_of_students_distribution_of_two_degrees():
    noise = errors("heavy tails", 2)
    assert stats.kstest(noise.ravel() / 0.5, stats.t(2).cdf).pvalue > FALSE_ALARM
    assert np.isfinite(noise).all()
    assert abs(stats.spearmanr(noise[0].ravel(), noise[1].ravel()).statistic) < 0.05


def test_late_noise_starts_at_its_step():
    noise = errors("late noise", 4)
    assert np.all(noise[:2] == 0)
    assert stats.kstest(noise[2:].ravel() / 0.5, stats.norm.cdf).pvalue > FALSE_ALARM


def numbered(k):
    """Messages that hold the number of their step."""
    return constant_messages(value=float(k))


def lost(name, steps):
    """Whether each message of the steps from 1 on is lost: the last one received is held in its place."""
    values = np.array([out.values for out in transmit(build(name), steps, numbered)])
    assert all((values[1:][k] <= k + 1).all() for k in range(steps - 1))
    older = values[1:] != np.arange(1, steps)[:, None, None, None, None]
    held = np.where(older, values[:-1], values[1:])
    assert np.array_equal(values[1:], held)
    return older[:, :, 0]


def test_a_lost_message_is_replaced_by_the_last_one_received():
    gone = lost("loss", 30)
    assert stats.binomtest(int(gone.sum()), gone.size, 0.4).pvalue > FALSE_ALARM


def test_messages_are_rounded_to_the_nearest_multiple_of_the_width():
    (out,) = transmit(build("uniform levels"), 1, lambda _: constant_messages(value=-3.13))
    assert set(out.values.ravel().tolist()) == {-3.25}


def test_bursts_are_the_chain_of_gilbert():
    bad = lost("bursts", 40)
    assert stats.binomtest(int(bad[0].sum()), bad[0].size, 0.2).pvalue > FALSE_ALARM
    assert stats.binomtest(int(bad[-1].sum()), bad[-1].size, 0.2).pvalue > FALSE_ALARM
    before, after = bad[:-1], bad[1:]
    for start, probability in ((False, 0.1), (True, 0.6)):
        tries = before == start
        assert stats.binomtest(int(after[tries].sum()), int(tries.sum()), probability).pvalue > FALSE_ALARM


def test_delays_are_uniform_and_messages_overtake_each_other():
    """The message of step k is the number k, so the received value is the time of sending."""

    received = np.array([out.values[:, 0] for out in transmit(build("random delay"), 60, numbered)])
    # With delays of 1..5 no message is younger than 1 step, and of simultaneous arrivals the last one sent counts.
    steps = np.arange(60)[:, None, None, None]
    assert (received[10:] <= steps[10:] - 1).all()
    assert (np.diff(received, axis=0) < 0).any()  # an older message arrives after a newer one
    ages = (steps - received)[10:]
    # Age 1 means that the message of the step before had delay 1: one in five.
    assert stats.binomtest(int((ages == 1).sum()), ages.size, 0.2).pvalue > FALSE_ALARM
    constant = np.array([out.values[:, 0] for out in transmit(build("constant delay"), 10, numbered)])
    assert constant[:, 0, 0, 0].tolist() == [0, 0, 0, 1, 2, 3, 4, 5, 6, 7]


def test_a_loss_that_never_happens_changes_nothing_for_the_stages_after_it():
    """A link that is down sends nothing, so no copy of an earlier message enters a delay."""
    generator = np.random.default_rng(3)
    live = generator.random((25, 2, 5, 6)) < 0.5
    sequence = [Messages(np.full((2, 5, 5, 6), float(k)), up, up.astype(float)) for k, up in enumerate(live)]
    delay, nothing = channel_part("Delay", steps=0, longest=3).build(), channel_part("AdditiveNoise", std=0.0).build()
    without = transmit(Chain([nothing, delay]), 25, sequence.__getitem__, 6)
    for kind in (channel_part("Loss", probability=0.0), channel_part("BurstLoss", to_bad=1e-12, to_good=1.0)):
        behind = transmit(Chain([kind.build(), delay]), 25, sequence.__getitem__, 6)
        for plain, other in zip(without, behind, strict=True):
            assert np.array_equal(plain.live, other.live)
            assert np.array_equal(plain.values * plain.live[:, None], other.values * other.live[:, None])


@pytest.mark.parametrize("name", CHANNELS)
def test_values_on_a_down_link_have_no_effect(name):
    channel, generator = build(name), np.random.default_rng(1)
    shape = (2, 5, 5, 6)
    sequence, garbled = [], []
    for _ in range(25):
        live = generator.random((2, 5, 6)) < 0.5
        values = generator.normal(size=shape)
        garbage = np.where(live[:, None], values, generator.normal(size=shape) * 1e3)
        sequence.append(Messages(values, live, live.astype(float)))
        garbled.append(Messages(garbage, live, live.astype(float)))
    received = 0
    for plain, other, sent in zip(
        transmit(channel, 25, sequence.__getitem__, 6),
        transmit(channel, 25, garbled.__getitem__, 6),
        sequence,
        strict=True,
    ):
        assert np.array_equal(plain.live, other.live)
        assert np.array_equal(plain.weights, other.weights)
        visible = plain.live & sent.live
        received += visible.sum()
        assert np.array_equal(plain.values * visible[:, None], other.values * visible[:, None])
    assert received > 100


@pytest.mark.parametrize("kind", ["physical", "scaled"])
def test_observation_does_not_depend_on_players_without_a_link(kind):
    world = World(FAULTY.replace(disturbance=None))
    encoder = Encoder(world, Interface(kind))
    generator = np.random.default_rng(0)
    states = [begin(world, [5])] * 2
    player = 0
    unlinked = [j for j in range(5) if j != player and j not in world.neighbours[:, player]]
    assert len(unlinked) == 2
    for _ in range(60):
        inputs = generator.normal(size=(5, 5, 1))
        others = inputs.copy()
        others[:, unlinked] = generator.normal(size=(5, 2, 1)) * 10
        first, second = (encoder.observe(state)[0] for state in states)
        assert np.array_equal(first[player], second[player])
        states = [dynamics.step(world, states[0], inputs), dynamics.step(world, states[1], others)]
    assert not np.array_equal(first[unlinked], second[unlinked])


def test_nested_chains_are_one_chain():
    outer = Chain([build("uniform levels"), Chain([build("loss")])])
    assert [type(stage).__name__ for stage in outer.stages] == ["UniformQuantiser", "Loss"]
    assert outer.is_random
    assert not Chain([build("constant delay"), build("uniform levels")]).is_random


REFUSED = {
    "delays in the wrong order": ("Delay", {"steps": 3, "longest": 2}, "longest must be a whole number of at least 3"),
    "no way out": ("BurstLoss", {"to_bad": 0.1, "to_good": 0.0}, "to_good must be a finite number above 0"),
    "no channel": ("Chain", {"stages": (3,)}, "the stages of a chain are channels, got a int"),
    "negative bias": ("Bias", {"bound": -1.0}, "bound must be a finite number of at least 0"),
    "no scale": ("HeavyTails", {"scale": math.nan}, "scale must be a finite number of at least 0"),
    "start before the start": ("LateNoise", {"std": 1.0, "step": -1}, "step must be a whole number of at least 0"),
    "no range": ("Range", {"limit": 0.0}, "limit must be a finite number above 0"),
    "unknown argument": ("Loss", {"rate": 0.1}, "has no argument 'rate'; choose from probability"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_invalid_channels_are_refused(name):
    kind, arguments, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        World(FIXED.replace(channel=channel_part(kind, **arguments)))


class Wrong(Channel):
    """A channel that answers what it should not."""

    kind: str = "nothing"

    def transmit(self, messages, memory, randomness):
        return {
            "nothing": None,
            "no memory": messages,
            "no messages": (messages.values, ()),
            "NaN": (replace(messages, values=messages.values * np.nan), ()),
            "another shape": (replace(messages, values=messages.values[:1]), ()),
        }[self.kind]


WRONG = {
    "nothing": "returned a NoneType",
    "no memory": "returned a Messages",
    "no messages": "returned a tuple",
    "NaN": "values have entries that are not finite",
    "another shape": r"values have the shape \(1, ",
}


@pytest.mark.parametrize("kind", WRONG)
def test_a_channel_that_answers_in_another_form_is_refused(kind):
    """Such values would otherwise be those of observations, and policies would be blamed."""
    with pytest.raises(ValueError, match=f"Wrong.transmit returns .messages, memory.*{WRONG[kind]}"):
        World(FIXED.replace(channel=Chain([channel_part("AdditiveNoise", std=0.3).build(), Wrong(kind)])))


class EveryLinkLive(Channel):
    """A channel that reports a message on every link, up or down."""

    is_random = False

    def transmit(self, messages, memory, randomness):
        return replace(messages, live=np.ones_like(messages.live), weights=np.ones_like(messages.weights)), ()


def test_down_links_stay_down_for_any_channel():
    world = World(SWITCHING.replace(channel=FactorySpec.of("test_channels:EveryLinkLive")))
    streams = [RandomStreams.from_seed(0)]
    game, randomness = world.draw_game(streams), world.draw_randomness(streams)
    state = dynamics.initial_state(world, world.draw_estimates(streams), game, randomness)
    live, weights = dynamics.graph_weights(world, state) > 0, dynamics.weights(world, state)
    assert live.any()
    assert not live.all()
    assert np.array_equal(weights > 0, np.broadcast_to(live, weights.shape))
