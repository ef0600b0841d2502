"""The sampled world and its laws against plain Python loops that share no code with the library."""

import numpy as np
import pytest
import reference_implementation as reference_loop
from worlds import BLOCKS, BLOCKS_SWITCHING, FROM_THE_PAPER, PAPER_START, make_env, play, while_running

from ptne_env import laws
from ptne_env.world.world import World

GRADIENTS = {
    "energy": reference_loop.energy_gradient,
    "energy-switching": reference_loop.energy_gradient,
    "energy-switching-transformed": reference_loop.energy_gradient,
    "non-quadratic": reference_loop.non_quadratic_gradient(4.0),
    "non-quadratic-switching": reference_loop.non_quadratic_gradient(4.0),
    "non-quadratic-printed": reference_loop.non_quadratic_gradient(1.0),
}
GRAPHS = {
    "energy": reference_loop.fixed(reference_loop.RING),
    "energy-switching": reference_loop.switching(reference_loop.PAPER_MODES, 0.1, "physical"),
    "energy-switching-transformed": reference_loop.switching(reference_loop.PAPER_MODES, 0.25, "transformed"),
    "non-quadratic": reference_loop.fixed(reference_loop.RING),
    "non-quadratic-switching": reference_loop.switching(reference_loop.PAPER_MODES, 0.1, "physical"),
    "non-quadratic-printed": reference_loop.fixed(reference_loop.RING),
}
LAWS = {
    "static": (laws.Static, lambda players: reference_loop.Static()),
    "adaptive": (laws.Adaptive, reference_loop.Adaptive),
    "grounded": (laws.Grounded, lambda players: reference_loop.Grounded()),
    "corollary-one": (laws.CorollaryOne, lambda players: reference_loop.CorollaryOne()),
}
OTHER_GAINS = {
    "static-tuned": (
        lambda layout: laws.Static(layout, kappa=1.5, gradient_gain=0.7),
        lambda players: reference_loop.Static(1.5, 0.7),
    ),
    "gadjov-pavel": (
        lambda layout: laws.CorollaryOne(layout, kappa=1.0),
        lambda players: reference_loop.CorollaryOne(1.0),
    ),
}
CASES = [*((name, law) for name in FROM_THE_PAPER for law in LAWS), *(("energy", law) for law in OTHER_GAINS)]
LAWS |= OTHER_GAINS


def reference_run(name, law, input_limit=1000.0, **settings):
    """All states of the independent loop from the paper's start."""
    table, world = reference_loop.step_table(**settings), {"gradient": GRADIENTS[name], "graph": GRAPHS[name]}
    start = PAPER_START.tolist()
    return reference_loop.run(start=start, owners=range(5), law=law, table=table, input_limit=input_limit, **world)


def assert_same_trajectory(ours, reference, tolerance=2e-6):
    reference = np.array(reference)
    assert ours.shape == reference.shape
    assert np.abs(ours - reference).max() <= tolerance * np.abs(reference).max()


@pytest.mark.parametrize(("name", "law"), CASES)
def test_law_follows_its_reference_from_the_paper_start(name, law):
    make, make_reference = LAWS[law]
    reference = reference_run(name, make_reference(5))
    env = make_env(name, interface="physical")
    ours, steps = play(env, make(env.layout))
    assert not steps[-1][4]["player_0"]["diverged"]
    assert_same_trajectory(ours, reference)


@pytest.mark.parametrize("name", ["energy", "energy-switching", "energy-switching-transformed"])
def test_hold_phase_follows_the_reference(name):
    settings = {"hold_steps": 50, "steps": 300, "s_end": 6.0, "deadline": 1.5, "gain": 10.0}
    env = make_env(name, **settings)
    ours, _ = play(env, laws.Adaptive(env.layout))
    assert_same_trajectory(ours, reference_run(name, reference_loop.Adaptive(5), **settings))


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("scenario", [BLOCKS, BLOCKS_SWITCHING], ids=lambda scenario: scenario.name)
def test_players_of_unequal_dimensions_follow_the_reference(scenario, law):
    make, make_reference = LAWS[law]
    start = np.random.default_rng(0).uniform(-20, 20, (3, 6))
    game, owners = World(scenario).game, [0, 0, 1, 2, 2, 2]
    links = [reference_loop.adjacency(3, [(0, 1)]), reference_loop.adjacency(3, [(1, 2)])]

    def switching(step):
        return links[0] if step["topology_s"] % 0.8 < 0.3 else links[1]

    reference = reference_loop.run(
        start=start.tolist(),
        owners=owners,
        gradient=reference_loop.affine_gradient(game.matrix.tolist(), game.offset.tolist(), owners),
        graph=switching
        if "switching" in scenario.name
        else reference_loop.fixed(reference_loop.adjacency(3, [(0, 1), (1, 2)])),
        law=make_reference(3),
        table=reference_loop.step_table(),
    )
    env = make_env(scenario, interface="physical")
    ours, _ = play(env, make(env.layout), options={"estimates": start})
    assert_same_trajectory(ours, reference)


def test_input_limit_binds_the_law_as_it_binds_its_reference():
    env = make_env("energy", input_limit=6.0)
    ours, steps = play(env, laws.Static(env.layout))
    reference = reference_run("energy", reference_loop.Static(), input_limit=6.0)
    assert_same_trajectory(ours, reference)
    assert np.abs(np.diff(ours, axis=0)).max() == pytest.approx(6.0 * env.world.clock.theta[0], rel=1e-9)
    assert sum(info["clipped"] for step in steps for info in step[4].values()) == 0  # no law exceeds the limit


def test_adaptive_gains_are_those_of_the_reference():
    env = make_env("energy-switching")
    law, reference = laws.Adaptive(env.layout), reference_loop.Adaptive(5)
    observations, _ = env.reset()
    memory = None
    for _ in while_running(env):
        actions, memory = law.predict(np.stack(list(observations.values())), state=memory)
        observations = env.step(dict(zip(list(env.agents), actions, strict=True)))[0]
    reference_run("energy-switching", reference)
    assert memory.shape == (5, 2)
    for i in range(5):
        for slot, j in enumerate(env.layout.neighbours[i]):
            assert memory[i, slot] == pytest.approx(reference.kappa[i][j], rel=2e-6)
            assert memory[i, slot] > 0.5
