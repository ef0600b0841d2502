"""Plan: save the state, simulate candidate inputs some steps ahead, and act with the best candidate.

The state of an environment is a record of arrays, and ``dynamics.step(world, state, inputs)`` is a pure function. So a
planner or a tree search can start from any state, as often as it needs, and leaves the environment unchanged.

Every 10 steps, random shooting draws 64 pairs of gains (one for the gradient, one for the consensus), simulates all of
them at once with the paper's law, and keeps the pair with the smallest residual: own gradients and disagreement, which
vanish together only at the Nash equilibrium. The planner reads the whole state, so it is an oracle, not a player.

Prints the digits at the deadline of the paper's static law and of the planner.

Run it with: python examples/planning.py
"""

import numpy as np

import ptne_env
from ptne_env.world import dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.world import World

CANDIDATES, HORIZON = 64, 10


def repeat(state: State, times: int) -> State:
    """Return copies of the state of one environment as a batch. Environments are the last axis of every array."""
    return state._replace(
        step=np.repeat(state.step, times),
        estimates=np.repeat(state.estimates, times, axis=2),
        own_gradients=np.repeat(state.own_gradients, times, axis=1),
        diverged=np.repeat(state.diverged, times),
    )


def inputs(world: World, state: State, gains: np.ndarray) -> np.ndarray:
    """Return the inputs of the paper's law, (n, N, B), for a gradient and a consensus gain per environment, (2, B)."""
    differences = dynamics.relative_estimates(world, state)
    u = gains[1] * np.einsum("dib,dcib->cib", dynamics.weights(world, state), differences)
    u[np.arange(world.game.dimension), world.game.owners] -= gains[0] * state.own_gradients
    return u


def simulate(world: World, state: State, gains: np.ndarray) -> State:
    """Return the state after the horizon, or at the end of the episode."""
    for _ in range(HORIZON):
        if not dynamics.is_over(world, state).all():
            state = dynamics.step(world, state, inputs(world, state, gains))
    return state


def residual(state: State) -> np.ndarray:
    """Return the sum of squares of own gradients and disagreement, shape (B,); infinite after divergence."""
    disagreement = state.estimates - state.estimates.mean(axis=1, keepdims=True)
    value = (state.own_gradients**2).sum(axis=0) + (disagreement**2).sum(axis=(0, 1))
    return np.where(state.diverged, np.inf, value)


def play(env: ptne_env.NashSeekingEnv, *, planning: bool) -> float:
    """Return the digits at the deadline, with planned gains or with those of the paper."""
    generator = np.random.default_rng(0)
    env.reset(seed=7)
    world, state = env.world, env.get_state()
    while not dynamics.is_over(world, state)[0]:
        gains = np.array([[1.0], [2.0]])
        if planning:
            candidates = gains * 2 ** generator.uniform(-3, 3, size=(2, CANDIDATES))
            after = simulate(world, repeat(state, CANDIDATES), candidates)
            gains = candidates[:, [residual(after).argmin()]]
        state = simulate(world, state, gains)
    env.set_state(state)  # the environment continues from any state
    error = np.linalg.norm(env.estimates - env.nash_equilibrium)
    return float(-np.log10(error / np.linalg.norm(np.broadcast_to(env.nash_equilibrium, env.estimates.shape))))


def main() -> None:
    """Compare the fixed gains with the planned gains on two graphs."""
    for scenario in ("energy", "energy-switching-transformed"):
        env = ptne_env.parallel_env(scenario, start="paper")
        law, planner = (play(env, planning=planning) for planning in (False, True))
        print(f"{scenario}: the static law reaches {law:.2f} digits, the planner {planner:.2f}")


if __name__ == "__main__":
    main()
