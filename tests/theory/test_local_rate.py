"""The local rate of gated laws at rest, against episodes."""

import numpy as np
import pytest
from affine_games import affine_scenario, random_affine
from worlds import fixed_part

from ptne_env import get_scenario
from ptne_env.field import laws as field_laws
from ptne_env.laws import settling
from ptne_env.perception.encoder import make_encoder
from ptne_env.theory.local_rate import local_radius
from ptne_env.theory.sampled import play
from ptne_env.world.world import World


def build(scenario):
    world = World(scenario)
    return world, field_laws.ObserverRelay(make_encoder(world, field_laws.ObserverRelay.interface).layout)


@pytest.mark.parametrize("seed", range(6))
def test_errors_near_the_equilibrium_shrink_at_the_local_rate(seed):
    generator = np.random.default_rng(seed)
    matrix, offset, adjacency = random_affine(generator, 4, coupling=1.0)
    world, law = build(affine_scenario(matrix, offset, fixed_part(adjacency), steps=60))
    radius = local_radius(world, law)
    estimates = world.start.draw(4, 4, np.random.default_rng(0))
    errors = np.linalg.norm(play(law, world, estimates).errors, axis=1)
    last = int(np.flatnonzero(errors > 1e-9)[-1])
    first = last // 2
    observed = (errors[last] / errors[first]) ** (1 / (last - first))
    assert observed == pytest.approx(radius, abs=0.06)


@pytest.mark.parametrize("curvature", [0.15, 0.3, 0.6])
def test_the_local_rate_of_a_rotating_game_includes_the_extrapolated_gradient(curvature, monkeypatch):
    monkeypatch.setattr(settling, "_RECOVERED", 0.0)  # so that the damping rests
    matrix = [[curvature, 1.0], [-1.0, curvature]]
    world, law = build(affine_scenario(matrix, [1.0, -2.0], fixed_part(1 - np.eye(2))))
    radius = local_radius(world, law)
    errors = np.linalg.norm(play(law, world, world.start.draw(2, 2, np.random.default_rng(0))).errors, axis=1)
    assert (errors[220] / errors[160]) ** (1 / 60) == pytest.approx(radius, abs=3e-3)


@pytest.mark.parametrize("name", ["robots", "weakly-monotone"])
def test_changes_by_rounding_do_not_count_as_noise_in_the_local_rate(name):
    """Both episodes reach the resolution of float64 long before the deadline; then copies would be averaged."""
    world, law = build(get_scenario(name))
    assert local_radius(world, law) < 0.8


def test_switching_topology_has_no_local_rate():
    world, law = build(get_scenario("random-energy-switching"))
    with pytest.raises(ValueError, match="fixed graph"):
        local_radius(world, law)
