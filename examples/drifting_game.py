"""Let the game drift while it is played, and measure how well laws track the moving equilibrium.

The preferred consumption of every player swings by ±5 around that of the paper's Example 1, once in a given period. The
state of an environment contains the game, so a drifting game is a loop: take the game of the next instant, set the
state, let the law act. The clock's gain c + 1/(T − t) grows, so tracking mostly gets better as the deadline comes
near.

Prints the tracking error ‖x − x*(t)‖/‖x*(t)‖ at fractions of the deadline, by period and law.

Run it with: python examples/drifting_game.py
"""

import numpy as np

import ptne_env
from ptne_env import laws
from ptne_env.games import EnergyGame

FRACTIONS = (0.25, 0.5, 0.75, 0.9, 0.99)


def game_at(time: float, period: float) -> EnergyGame:
    """Return the game of an instant; the players swing one after the other."""
    phases = 2 * np.pi * (time / period + np.arange(5) / 5)
    return EnergyGame(target=np.array([10.0, 15.0, 20.0, 25.0, 30.0]) + 5 * np.sin(phases))


def tracking_errors(make_law: type, period: float) -> np.ndarray:
    """Return the relative distance of the strategies to x*(t) after every step."""
    env = ptne_env.parallel_env("energy", start="paper", interface=make_law.interface)
    law, (observations, _) = make_law(env.layout), env.reset(seed=0)
    errors, memory = [], None
    for time in env.world.clock.t[1:]:
        env.set_state(env.get_state()._replace(game=game_at(time, period)))  # which players measure after the step
        actions, memory = law.predict(np.stack(list(observations.values())), state=memory)
        observations, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
        errors.append(np.linalg.norm(env.strategies - env.nash_equilibrium) / np.linalg.norm(env.nash_equilibrium))
    return np.array(errors)


def main() -> None:
    """Print the tracking errors of three laws in three drifts."""
    clock = ptne_env.parallel_env("energy").world.clock
    steps = np.searchsorted(clock.t, np.array(FRACTIONS) * clock.deadline)
    print("tracking error at t/T =        " + "  ".join(f"{fraction:6.2f}" for fraction in FRACTIONS))
    for period in (8.0, 2.0, 0.5):
        for make_law in (laws.Static, laws.Grounded, laws.Relay):
            errors = tracking_errors(make_law, period)[steps - 1]
            label = f"one swing in {period:3.1f} s, {make_law.__name__.lower()}"
            print(f"{label:31}" + "  ".join(f"{error:6.4f}" for error in errors))


if __name__ == "__main__":
    main()
