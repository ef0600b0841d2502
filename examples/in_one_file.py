"""The whole idea in one file, with numpy and scipy alone: a game, a switching graph, a clock, a law, and the loop.

Five buildings buy electricity. Each pays more when the others consume more, so the best amount for one depends on all
others. At exactly one point, the Nash equilibrium (NE), no building can lower its own cost alone. The buildings must
reach it by a deadline T, although each knows only its own cost and receives messages only from its live neighbours.

This is the scenario ``energy-switching-transformed`` under the law ``static``. The library computes the same numbers,
bit for bit, and a test compares them. Equation numbers are those of the paper, Feng and Hu, "Prescribed-Time Fully
Distributed Nash Equilibrium Seeking in Noncooperative Games".

Prints how many digits of all estimates are correct at ten instants, the NE, and the strategies at the deadline.

Run it with: python examples/in_one_file.py
"""

import numpy as np
from scipy.special import wrightomega

# 1. The game (Example 1). Player i consumes x_i and pays
#
#        J_i(x) = (x_i − b_i)² + (0.1 Σ_j x_j + 10) x_i.
#
#    It wants to consume b_i, and the price of a unit rises with the total consumption. Its own gradient is
#
#        ∂J_i/∂x_i = 2 (x_i − b_i) + 0.1 Σ_j x_j + 10 + 0.1 x_i.
#
#    All five own gradients vanish at the NE x*, which solves a linear system. The players do not know x*.

N = 5
TARGET = np.array([10.0, 15.0, 20.0, 25.0, 30.0])  # b
COUPLING, BASE_PRICE = 0.1, 10.0

NASH_EQUILIBRIUM = np.linalg.solve((2 + COUPLING) * np.eye(N) + COUPLING, 2 * TARGET - BASE_PRICE)


def own_gradient(estimate: np.ndarray, player: int) -> float:
    """Return ∂J_i/∂x_i at the player's own estimate x^i of all strategies, shape (N,)."""
    gradient = estimate.sum() * COUPLING
    gradient += (2 + COUPLING) * estimate[player]
    gradient += BASE_PRICE - 2 * TARGET[player]
    return gradient


# 2. The estimates. Player i cannot see the strategies of the others, so it keeps an estimate x^i of all N strategies.
#    Row i of the array below is x^i. Its own entry x^i_i is no estimate: it is the player's real strategy x_i.


def start() -> np.ndarray:
    """Return the paper's start: strategies −2, −4, …, −10; each player believes that the others play 15, 10, 5, 0."""
    return np.array([np.insert([15.0, 10.0, 5.0, 0.0], i, -2.0 * (i + 1)) for i in range(N)])


# 3. The graph. Two links are up at a time, and the four modes take turns. No mode connects all players, but their
#    union does: it is the 5-cycle 0-1-2-3-4-0. Each mode lasts 0.25 units of the transformed time s, see 4.

MODES = [[(0, 1), (2, 3)], [(1, 2), (3, 4)], [(2, 3), (4, 0)], [(3, 4), (0, 1)]]
DWELL = 0.25


def live_neighbours(player: int, s: float) -> list[int]:
    """Return the players from whom a player receives an estimate at the transformed time s."""
    links = MODES[int(s // DWELL) % len(MODES)]
    return [i + j - player for i, j in links if player in (i, j)]


# 4. The clock. Player i chooses an input u^i, and its estimate moves with a gain that explodes at the deadline T (10):
#
#        dx^i/dt = (c + 1/(T − t)) u^i.
#
#    The time transformation t = λ(s) = T (1 − e^(−s)) maps the infinite time s onto [0, T), and then (9, 13)
#
#        dx^i/ds = (1 + c λ'(s)) u^i.
#
#    The gain is now bounded. The effective time τ = s + c t absorbs it as well, because dτ/ds = 1 + c λ'(s):
#
#        dx^i/dτ = u^i.
#
#    So a step that holds the input from τ_k to τ_{k+1} is exact, without any integration error:
#
#        x^i_{k+1} = x^i_k + Θ_k u^i_k   with   Θ_k = τ_{k+1} − τ_k = Δs_k + c Δt_k.
#
#    The K steps are equally long in τ. They stop at s = 8, where t is 0.03 % short of T.

T, C, K, S_END = 1.2, 20.0, 400, 8.0


def clock() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the instants t_k and s_k, each of shape (K + 1,), and the steps Θ_k, of shape (K,)."""
    tau = np.linspace(0.0, 1.0, K + 1) * (S_END + C * T * -np.expm1(-S_END))
    s = tau - C * T + wrightomega(np.log(C * T) + C * T - tau)  # solves s + c λ(s) = τ for s
    s[0], s[-1] = 0.0, S_END
    t = T * -np.expm1(-s)
    return t, s, np.diff(s) + C * np.diff(t)


# 5. The law. A player knows its own gradient and, for each live neighbour j, the difference x^j − x^i. The static law
#    (Theorem 1) goes down the gradient with its own strategy, and moves the whole estimate towards the neighbours:
#
#        u^i = −R_i^T ∂J_i/∂x_i(x^i) − κ Σ_j a_ij (x^i − x^j),
#
#    where R_i^T puts the own gradient into the player's own entry.

KAPPA, INPUT_LIMIT = 2.0, 1000.0


def static_law(player: int, gradient: np.float32, differences: np.ndarray) -> np.ndarray:
    """Return the input u^i, shape (N,), for an own gradient and differences (live neighbours, N); all float32."""
    u = KAPPA * differences.astype(np.float64).sum(axis=0)
    u[player] -= np.float64(gradient)
    return np.clip(u, -INPUT_LIMIT, INPUT_LIMIT).astype(np.float32)


# 6. The loop. The state and all arithmetic are float64, but observations and actions are float32, as in most libraries
#    of reinforcement learning. Differences are subtracted in float64 and rounded afterwards. So the rounding error is
#    relative to the differences, which vanish at the NE, and float32 does not limit the accuracy of the estimates.


def play() -> np.ndarray:
    """Return the estimates at all instants, shape (K + 1, N, N), in which entry [k, i] is x^i at instant k."""
    _, instants, steps = clock()
    estimates = start()
    trajectory = [estimates]
    for s, theta in zip(instants, steps, strict=False):  # the last instant is the deadline: no step follows
        inputs = np.empty((N, N))
        for i in range(N):
            gradient = np.float32(own_gradient(estimates[i], i))
            differences = (estimates[live_neighbours(i, s)] - estimates[i]).astype(np.float32)
            inputs[i] = static_law(i, gradient, differences)
        estimates = estimates + theta * inputs
        trajectory.append(estimates)
    return np.array(trajectory)


def digits(estimates: np.ndarray) -> float:
    """Return −log10 of the relative distance of all estimates from the NE; 3 means an error of 0.1 %."""
    error = np.linalg.norm(estimates - NASH_EQUILIBRIUM) / (np.sqrt(N) * np.linalg.norm(NASH_EQUILIBRIUM))
    return float(-np.log10(error))


# 7. Things to try. With all links up, MODES = [[(0, 1), (1, 2), (2, 3), (3, 4), (4, 0)]], the same law reaches 4.02
#    digits. With a larger c or s_end it reaches more, until float64 cannot tell t from T. With a shorter DWELL the
#    graph mixes better. How many digits does another law reach from the same observations?


def main() -> None:
    """Play the episode and print it."""
    t, s, _ = clock()
    trajectory = play()
    for k in range(K // 10, K + 1, K // 10):
        print(f"t = {t[k]:.4f} s   s = {s[k]:.2f}   {digits(trajectory[k]):.2f} digits")
    print("the Nash equilibrium is ", NASH_EQUILIBRIUM.round(3))
    print("strategies at the deadline", trajectory[-1].diagonal().round(3))


if __name__ == "__main__":
    main()
