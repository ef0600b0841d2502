"""The random worlds: those of the published seed never change, all can be built, and cover what they promise."""

import json
import re
import warnings
from dataclasses import replace
from hashlib import sha256

import numpy as np
import pytest

from ptne_env.evaluation import POLICIES, EpisodeSet
from ptne_env.evaluation.comparison import compare
from ptne_env.games import require_strong_monotonicity
from ptne_env.shared.parts import foreign_targets
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.suites import get_suite
from ptne_env.suites.robustness import robustness

FIELDS = ("game", "topology", "start", "deadline", "gain", "steps", "s_end", "input_limit", "channel", "message_range")
SEEDS = (1, 12)
"""That for tuning, and another one that nothing is tuned on."""


@pytest.fixture(scope="module")
def tracks():
    """The 200 tracks of the seeds, with their worlds."""
    return [track for seed in SEEDS for track in robustness(seed).tracks]


@pytest.fixture(scope="module")
def worlds(tracks):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return [track.world for track in tracks]


def test_the_worlds_of_the_published_seed_never_change():
    published = get_suite("robustness")
    scenarios = [track.scenario.to_dict() for track in published.tracks]
    text = json.dumps([[scenario[field] for field in FIELDS] for scenario in scenarios])
    assert sha256(text.encode()).hexdigest() == "711d487e6769082417b96891944de68d0fcf4ffa85360e4ef59590c149ded82f"
    assert published == robustness(1)


def stages(tracks, target):
    """The arguments of all stages of a kind."""
    chains = [dict(track.scenario.channel.arguments)["stages"] for track in tracks]
    return [dict(stage.arguments) for chain in chains for stage in chain if stage.target == target]


def test_worlds_are_valid_and_mixed(tracks, worlds):
    players = np.array([world.game.num_players for world in worlds])
    steps = np.array([world.clock.steps for world in worlds])
    assert len(worlds) == 200
    assert players.min() == 2
    assert 90 <= players.max() <= 100
    assert (players > 9).sum() <= 30
    assert steps.min() >= 50
    assert steps.max() <= 2000
    assert sum(np.isfinite(world.message_range) for world in worlds) == 100
    assert sum(world.channel.is_perfect for world in worlds) >= 40
    assert {world.topology.clock for world in worlds if world.topology.dwells} == {"physical", "transformed"}
    dwells = [world.topology.mode_dwells for world in worlds if len(set(world.topology.mode_dwells)) > 1]
    assert max(max(times) / min(times) for times in dwells) > 3
    assert max(stage["longest"] for stage in stages(tracks, "channel:delay")) == 20
    assert max(stage["probability"] for stage in stages(tracks, "channel:loss")) > 0.7
    liars = [track.change.count("liar") for track in tracks]
    assert liars.count(1) >= 5
    assert liars.count(2) >= 3
    for track, world in zip(tracks, worlds, strict=True):
        assert foreign_targets(track.to_dict()) == []
        assert track.change.endswith(".")
        assert "|" not in track.change  # which would end a cell of a table
        game = world.game
        if game.is_affine:
            require_strong_monotonicity(game)  # as a world does for every draw of a family
        else:
            assert world.game_family.is_strongly_monotone
        assert np.abs(game.nash_equilibria).max() < world.message_range / 2


def test_starts_and_equilibria_have_all_scales(tracks, worlds):
    widest = np.array([np.abs(world.draw_estimates([RandomStreams.from_seed(0)])).max() for world in worlds])
    sizes = np.array([np.abs(world.game.nash_equilibria).max() for world in worlds])
    ratios = widest[(widest > 0) & (sizes > 0)] / sizes[(widest > 0) & (sizes > 0)]
    assert ratios.min() < 1e-11
    assert ratios.max() > 1e5
    assert sizes[sizes > 0].min() < 1e-5
    assert sizes.max() > 300
    assert sum("x* = 0" in track.change for track in tracks) >= 6
    assert sum("starts at 0" in track.change for track in tracks) == 10
    at_equilibrium = [world for track, world in zip(tracks, worlds, strict=True) if "starts at x*" in track.change]
    assert len(at_equilibrium) == 14
    for world in at_equilibrium:
        start, equilibrium = world.draw_estimates([RandomStreams.from_seed(0)]), world.game.nash_equilibria[:, None]
        np.testing.assert_allclose(start - equilibrium, 0, atol=1e-12 * world.game.equilibrium_scale[0])


def coupling(world):
    """A of the game, or of its family's typical member, without its diagonal."""
    matrix = world.game.jacobian(np.zeros((world.game.dimension, 1)))[..., 0]
    return matrix - np.diag(np.diag(matrix))


def test_games_rotate_complement_and_share_sums_as_their_descriptions_say(tracks, worlds):
    turning = []
    for track, world in zip(tracks, worlds, strict=True):
        matrix = coupling(world)
        if "rotating" in track.change:
            turning.append(np.linalg.norm(matrix - matrix.T, 2) / 2)
        if "complements" in track.change:
            assert matrix.max() <= 0
        if rank := re.search(r"coupling of rank (\d)", track.change):
            # Where the diagonal is free, a matrix of this rank has no larger block away from the diagonal.
            half = len(matrix) // 2
            assert np.linalg.matrix_rank(matrix[:half, half:], tol=1e-5) <= int(rank[1])
    assert len(turning) >= 20
    assert min(turning) < 1.5
    assert max(turning) > 20


def test_the_papers_law_diverges_in_none_of_the_quickest_worlds():
    suite = robustness(1)
    work = {track.name: track.scenario.steps * track.world.game.num_players**2 for track in suite.tracks}
    quickest = sorted(work, key=work.get)[:12]
    tracks = [replace(suite.track(name), episodes=2) for name in quickest]
    results = compare(suite.name, tracks, [POLICIES["static"]], {name: EpisodeSet(2) for name in quickest})
    assert [results.summary(name, "static", "diverged_share").mean for name in quickest] == [0] * 12
