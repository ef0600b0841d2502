"""Models of the neighbours' reactions: planes from resting messages, and the joint solution."""

from types import SimpleNamespace

import numpy as np
import pytest

from ptne_env.field.laws.reactions import Condition, initial_covariance, joint_solution, learned_planes, reaction_parts
from ptne_env.laws.memory import Parts

GENERATOR = np.random.default_rng(3)
DIMS = (2, 1, 2)
N, TOTAL = len(DIMS), sum(DIMS)
OWNERS = np.repeat(np.arange(N), DIMS)
LAYOUT = SimpleNamespace(
    slots=2,
    dimension=TOTAL,
    action_dims=DIMS,
    neighbours=((1, 2), (0, 2), (0, 1)),
    own_components=np.array([[0, 1], [2, TOTAL], [3, 4]]),
    own_mask=np.arange(N)[:, None] == OWNERS,
)
MATRIX = GENERATOR.uniform(-0.3, 0.3, (TOTAL, TOTAL)) + 2 * np.eye(TOTAL)
OFFSET = GENERATOR.uniform(-3, 3, TOTAL)
EQUILIBRIUM = np.linalg.solve(MATRIX, -OFFSET)


def respond(player, estimate):
    """An estimate in which the own components of a player are the best response to the others."""
    own = player == OWNERS
    x = estimate.copy()
    x[own] = np.linalg.solve(MATRIX[np.ix_(own, own)], -OFFSET[own] - MATRIX[own][:, ~own] @ x[~own])
    return x


def watch(steps, rest=2):
    """The memory of player 0 after it has seen its neighbours at rest at points of their reaction planes."""
    here = np.full((1, TOTAL), 10.0)
    parts = Parts(reaction_parts(LAYOUT) | {"live": (2,), "messages": (2, TOTAL), "steps": (1,)})
    memory = parts.zeros(1)
    memory["plane_covariance"][...] = initial_covariance(LAYOUT)
    memory["steps"] += 3
    for _ in range(steps):
        points = [respond(player, GENERATOR.normal(size=TOTAL) * 5) for player in (1, 2)]
        messages = np.stack(points)[None]
        for _ in range(rest):
            sight = SimpleNamespace(
                player=np.zeros(1, dtype=int),
                weights=np.ones((1, 2)),
                own_estimate=here,
                relative_estimates=messages - here[:, None],
            )
            memory = memory | learned_planes(sight, memory, LAYOUT, here)
            memory |= {"live": np.ones((1, 2)), "messages": messages.copy(), "steps": memory["steps"] + 1}
    return memory


def test_planes_of_resting_neighbours_are_identified():
    planes = watch(12)["planes"][0]
    for slot, player in enumerate((1, 2)):
        own = player == OWNERS
        exact = -np.linalg.solve(MATRIX[np.ix_(own, own)], MATRIX[own][:, ~own])
        assert planes[slot, : own.sum()][:, ~own] == pytest.approx(exact, abs=1e-4)


def test_moving_messages_are_no_samples():
    assert (watch(12, rest=1)["plane_samples"] == 0).all()


def solve(memory, step=50.0, doubt=0.0):
    """The joint solution of player 0, one unit away from the equilibrium in every component."""
    here, own = EQUILIBRIUM[None] + 1.0, LAYOUT.own_components[:1]
    gradient = (MATRIX @ here[0] + OFFSET)[None, :2]
    condition = Condition(MATRIX[None, :2], gradient, own, np.full((1, 1), doubt))
    memory = memory | {"steps": np.full((1, 1), step)}
    return joint_solution(np.zeros(1, dtype=int), memory, LAYOUT, here, here, condition)


def test_joint_solution_of_all_planes_is_the_equilibrium():
    found = solve(watch(20))
    assert found.is_trusted.all()
    assert found.point[0] == pytest.approx(EQUILIBRIUM, abs=1e-3)


def test_joint_solution_is_not_trusted_early_or_while_planes_err():
    memory = watch(20)
    assert not solve(memory, step=10.0).is_trusted.any()
    assert not solve(memory, doubt=0.5).is_trusted.any()
    assert not solve(memory | {"plane_error": np.full((1, 2), 0.5)}).is_trusted.any()


def test_planes_with_few_samples_leave_the_plan_alone():
    found = solve(watch(2))
    assert found.point[0, 2:] == pytest.approx(EQUILIBRIUM[2:] + 1.0)
