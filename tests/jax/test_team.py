"""Teammates in training: they follow their law, do not learn, and are refused where they follow another one."""

import dataclasses
import functools

import pytest

jax = pytest.importorskip("jax")

import numpy as np
from small_suite import STRANGERS

import ptne_env.jax
from ptne_env import FactorySpec
from ptne_env.learn import recurrent
from ptne_env.training import jax_ppo, through_world
from ptne_env.training.configuration import Configuration
from ptne_env.training.team import Team

TRACK = "small_suite:TEAMS/strangers"


@functools.cache
def world(kind="physical"):
    return ptne_env.jax.JaxWorld(STRANGERS.scenario, interface=kind, pool=5)


def law_of_the_teammate(state):
    """The inputs (n, B) of player 3, which follows the static law."""
    law, limit = ptne_env.jax.static(world().layout, kappa=0.4), world().layout.input_limit
    inputs = jax.vmap(lambda row: law.act(law.params, row, ())[0], -1, -1)(world().observe(state)[:, 3])
    return np.clip(inputs, -limit, limit)


def moves(before, after):
    return (after.estimates - before.estimates) / world().numpy.clock.theta[0]


def test_teammates_follow_their_law_within_the_input_limit():
    team, state = Team(STRANGERS, world("scaled")), world().reset(jax.random.key(0), 2)
    assert team.learners.tolist() == [0, 1, 2, 4]
    state = state._replace(estimates=state.estimates * np.array([1.0, 1e4]))  # the second one asks for too much
    inputs = np.asarray(team.complete(state, 7 + 0 * state.estimates))
    expected = law_of_the_teammate(state)
    assert np.abs(expected).max(axis=0)[1] == world().layout.input_limit
    np.testing.assert_allclose(inputs[:, 3], expected, rtol=1e-4)
    assert (inputs[:, team.learners] == 7).all()


def test_teammates_of_another_law_are_refused():
    team = dataclasses.replace(STRANGERS.teammates, policy=FactorySpec.of("law:grounded"))
    with pytest.raises(ValueError, match=r"follow static\(\); those of 'strangers': grounded\(\)"):
        Team(dataclasses.replace(STRANGERS, teammates=team), world())


def test_ppo_acts_for_the_other_players_alone():
    it = jax_ppo.Learner(Configuration(TRACK, "mappo-rnn", batch=80, rollout=10, minibatches=2, hidden=(8, 6)))
    state = it.world.reset(jax.random.key(0), 2)
    assert it._observe(state).shape == (it.layout.size, 8)
    actions = np.random.default_rng(0).normal(size=(5, 8)).astype(np.float32)
    moved = moves(state, it._act(state, actions))
    np.testing.assert_allclose(moved[:, 3], law_of_the_teammate(state), rtol=1e-4)
    alone = it.world.inputs(state, np.insert(actions.reshape(5, 4, 2), 3, 0, axis=1))
    np.testing.assert_allclose(moved[:, [0, 1, 2, 4]], alone[:, [0, 1, 2, 4]], rtol=1e-6, atol=1e-9)


def test_training_through_the_world_counts_the_other_players_alone():
    settings = through_world.Settings(TRACK, cells=50, window=5, hidden=4, slot_hidden=3)
    lesson = through_world.Lesson(STRANGERS, settings, jax.random.key(0))
    weights = recurrent.initial_weights(np.random.default_rng(0), 4, 3)
    (after, _), loss = jax.jit(lesson._step)(weights, lesson._carry)
    before = lesson._carry[0]
    np.testing.assert_allclose(moves(before, after)[:, 3], law_of_the_teammate(before), rtol=1e-4)
    errors = after.estimates - np.asarray(after.game.nash_equilibria)[:, None]
    distance = np.linalg.norm(errors, axis=0) / after.game.equilibrium_scale
    np.testing.assert_allclose(loss, np.log10(distance)[lesson._team.learners].sum() / distance.size, rtol=1e-6)
