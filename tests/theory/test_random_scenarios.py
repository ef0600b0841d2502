"""Certificates of random scenarios, stable and unstable: none fails, and episodes keep every promise."""

import itertools
import json
import warnings
from collections import Counter

import numpy as np
import pytest
from affine_games import SOAK
from random_affine import encoder_of
from random_scenarios import random_scenario

from ptne_env import FactorySpec, theory
from ptne_env.evaluation.rollout import rollout
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import dynamics

SEEDS = range(500 if SOAK else 30)
TELLING = {
    "negative variances": (124, 127, 152),
    "rounding that early steps amplify": (314, 669),
    "a worst start with a hold phase": (101, 105),
    "a hold phase with longer steps": (427,),
}
"""Seeds of scenarios that certificates once got wrong."""
MOST_DIGITS = 12.0
"""Beyond these digits float64 limits an episode, and every comparison stops."""
EPISODES = 100
"""Noisy episodes per scenario; their mean square is then known to a seventh, or better."""
CLOSE = 1e-3
"""Difference of digits that rounding to float32 may cause."""


class Promises:
    """A certificate, and the episodes that it is about."""

    def __init__(self, seed):
        self.drawn = random_scenario(seed)
        self.scenario = self.drawn.scenario
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of steps that end short of the deadline
            self.certificate = theory.certify(
                self.scenario,
                law=self.drawn.law,
                noise_std=self.drawn.noise_std,
                delay_steps=self.drawn.delay,
                delay_limit=4,
            )
        self.encoder = encoder_of(self.scenario)
        world = self.encoder.world
        self.law = theory.build_law(self.drawn.law, world)
        n, players = world.game.dimension, world.game.num_players
        self.start = world.start.draw(players, n, np.random.default_rng(0))[:, :, None]

    def digits(self, starts, channel=None):
        """−log10 of the estimate distance at every instant, shape (K+H+1, B)."""
        encoder = encoder_of(self.scenario.replace(channel=channel)) if channel else self.encoder
        streams = [RandomStreams.from_seed(seed) for seed in range(starts.shape[2])]
        randomness = encoder.world.draw_randomness(streams)
        played = rollout(self.law, encoder, dynamics.initial_state(encoder.world, starts, randomness=randomness))
        return -np.log10(np.maximum(played["estimate_distance"], 1e-300))


def same(predicted, measured):
    return abs(min(predicted, MOST_DIGITS) - min(measured, MOST_DIGITS)) <= CLOSE


def broken_promises(seed, kept):
    """The names of the promises of a scenario that its episodes break; ``kept`` counts the others."""
    case = Promises(seed)
    certificate, broken = case.certificate, []
    data = certificate.to_dict()
    assert json.loads(json.dumps(data, allow_nan=False)) == data

    def promise(name, holds):
        kept[name] += bool(holds)
        if not holds:
            broken.append(name)

    deadline = case.scenario.steps
    measured = case.digits(case.start)[:, 0]
    if certificate.digits_are_exact:
        promise("digits at T", same(certificate.digits_sampled, measured[deadline]))
        if certificate.digits_after_hold is not None:
            promise("digits after the hold phase", same(certificate.digits_after_hold, measured[-1]))
    elif certificate.digits_sampled is not None:
        promise("a note instead of exact digits", any("exact" in note or "limit" in note for note in certificate.notes))
    unlimited = case.scenario.input_limit > 1e5  # other starts, and noise, may ask for more than the certified one
    if certificate.digits_are_exact and certificate.worst_digits_gained is not None and unlimited:
        others = np.random.default_rng(seed).uniform(-20, 20, (*case.start.shape[:2], 3))
        path = case.digits(others)
        gained = np.minimum(path[deadline], MOST_DIGITS) - path[0]
        worst = min(certificate.worst_digits_gained, MOST_DIGITS - path[0].max())
        promise("digits gained from the worst start", np.all(gained >= worst - CLOSE))
    delay = certificate.delay
    if delay is not None and delay.digits_are_exact and delay.digits is not None and delay.steps:
        late = FactorySpec.of("ptne_env.world.channel:Delay", steps=delay.steps)
        promise("digits under delay", same(delay.digits, case.digits(case.start, late)[deadline, 0]))
    noise = certificate.noise
    steady = not certificate.frozen_gains  # gains that adapt grow with the noise, as a note says
    if noise is not None and noise.std and certificate.digits_are_exact and steady and unlimited:
        noisy = FactorySpec.of("ptne_env.world.channel:AdditiveNoise", std=noise.std)
        squares = 10 ** (-2 * case.digits(np.repeat(case.start, EPISODES, axis=2), noisy)[deadline])
        spread = squares.std() / np.sqrt(EPISODES)
        promise("digits under noise", abs(squares.mean() - 10 ** (-2 * noise.digits)) <= 6 * spread)
    if certificate.guaranteed_digits is not None:
        promise("guaranteed digits", min(certificate.guaranteed_digits, MOST_DIGITS) <= measured[deadline] + CLOSE)
    return broken


def test_no_random_scenario_fails_and_no_promise_is_broken():
    kept, broken = Counter(), {}
    for seed in sorted({*SEEDS, *itertools.chain.from_iterable(TELLING.values())}):
        names = broken_promises(seed, kept)
        if names:
            broken[seed] = names
    assert not broken
    assert min(kept.values()) > 0, kept


@pytest.mark.parametrize("seed", TELLING["rounding that early steps amplify"])
def test_steps_that_amplify_rounding_have_a_note_and_no_exact_digits(seed):
    case = Promises(seed)
    certificate, measured = case.certificate, case.digits(case.start)[case.scenario.steps, 0]
    assert certificate.step_margin < 1
    assert certificate.digits_sampled > measured + 0.5
    assert not certificate.digits_are_exact
    assert any("amplifies errors" in note for note in certificate.notes)


@pytest.mark.parametrize("seed", TELLING["negative variances"])
def test_noise_of_steps_that_amplify_errors_has_variances_above_zero(seed):
    loop = theory.sampled_loop(Promises(seed).encoder.world, Promises(seed).law)
    covariance = loop.noise_covariance()
    assert np.all(np.diag(covariance) >= 0)
    assert np.trace(covariance) > 0
