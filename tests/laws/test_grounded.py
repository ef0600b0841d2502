import numpy as np
import pytest
from worlds import make_env, play

from ptne_env import laws


@pytest.mark.parametrize("kind", ["physical", "local"])
def test_twelve_digits_survive_float32_observations_and_actions(kind):
    env = make_env("energy", interface=kind)
    states, steps = play(env, laws.Grounded(env.layout, kappa=2.0))
    equilibrium = env.nash_equilibrium
    scale = np.linalg.norm(equilibrium)
    assert np.linalg.norm(env.strategies - equilibrium) / scale < 1e-12
    assert np.linalg.norm(states[-1] - equilibrium) / (np.sqrt(5) * scale) < 1e-12
    assert all(action.dtype == np.float32 for action in steps[0][0].values())


def test_own_strategy_follows_its_own_gradient_alone():
    env = make_env("energy")
    observations, _ = env.reset(seed=0, options={"estimates": np.random.default_rng(0).uniform(-20, 20, (5, 5))})
    for kappa in (0.0, 2.0, 50.0):
        actions, _ = laws.Grounded(env.layout, kappa).predict(np.stack(list(observations.values())))
        gradients = [env.layout.select(row, "own_gradient")[0] for row in observations.values()]
        assert np.array_equal(actions.diagonal(), -np.array(gradients))
