"""The sampled world and its laws a second time, in plain Python loops, from the equations alone.

It imports nothing from the library and vectorises nothing: an estimate is a list, a graph a list of lists, and a step a
loop over players, components and neighbours. Only the exponential time transformation
and the steps that are uniform in effective time are needed.
"""

import math

# --- time ----------------------------------------------------------------------------------------------------------


def step_table(*, deadline=1.2, gain=20.0, steps=400, s_end=8.0, hold_steps=0):
    """One dictionary per step: t, s, theta, dt, and the clocks that topologies follow."""

    def time(s):
        return deadline * (1 - math.exp(-s))

    def invert(tau):
        low, high = 0.0, s_end
        for _ in range(200):
            middle = (low + high) / 2
            if middle + gain * time(middle) < tau:
                low = middle
            else:
                high = middle
        return (low + high) / 2

    end = s_end + gain * time(s_end)
    grid = [0.0] + [invert(end * k / steps) for k in range(1, steps)] + [s_end]
    table = []
    for k in range(steps):
        dt = time(grid[k + 1]) - time(grid[k])
        theta = grid[k + 1] - grid[k] + gain * dt
        table.append({"t": time(grid[k]), "s": grid[k], "theta": theta, "dt": dt, "topology_s": grid[k]})
    mean = sum(step["theta"] for step in table) / steps
    for k in range(hold_steps):
        dt = mean / gain
        t = deadline + k * dt
        table.append({"t": t, "s": s_end, "theta": mean, "dt": dt, "topology_s": s_end + gain * (t - deadline)})
    return table


# --- graphs ---------------------------------------------------------------------------------------------------------


def adjacency(players, edges):
    matrix = [[0.0] * players for _ in range(players)]
    for i, j in edges:
        matrix[i][j] = matrix[j][i] = 1.0
    return matrix


RING = adjacency(5, [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0)])

PAPER_MODES = [
    adjacency(5, [(0, 1), (2, 3)]),
    adjacency(5, [(1, 2), (3, 4)]),
    adjacency(5, [(2, 3), (4, 0)]),
    adjacency(5, [(3, 4), (0, 1)]),
]


def fixed(matrix):
    return lambda step: matrix


def switching(modes, dwell, clock):
    def active(step):
        now = step["t"] if clock == "physical" else step["topology_s"]
        return modes[math.floor(now / dwell) % len(modes)]

    return active


# --- games: own gradient of player i at its own estimate -------------------------------------------------------------


def energy_gradient(i, x):
    targets = [10.0, 15.0, 20.0, 25.0, 30.0]
    return [2 * (x[i] - targets[i]) + 0.1 * math.fsum(x) + 10.0 + 0.1 * x[i]]


def non_quadratic_gradient(weight_of_fourth):
    """Example 2; the weight of x4 in J4 is 1 as printed and 4 where the printed equilibrium is right."""

    def gradient(i, x):
        x1, x2, x3, x4, x5 = x
        if i == 0:
            return [x1 + x2 + x3 + x4 + x5]
        if i == 1:
            return [math.exp(x2 / 2) / 4 + x4]
        if i == 2:
            return [x3]
        if i == 3:
            return [weight_of_fourth + 2 * x4]
        return [2 * x5 - 5]

    return gradient


def affine_gradient(matrix, offset, owners):
    """F(x) = A x + q, each player knowing its own rows."""

    def gradient(i, x):
        rows = [c for c, owner in enumerate(owners) if owner == i]
        return [sum(matrix[r][c] * x[c] for c in range(len(x))) + offset[r] for r in rows]

    return gradient


# --- the laws ---------------------------------------------------------------------------------------------------------


class Static:
    """u^i = −R_iᵀ ∂J_i(x^i) − κ Σ_j a_ij (x^i − x^j)."""

    def __init__(self, kappa=2.0, gradient_gain=1.0):
        self.kappa, self.gradient_gain = kappa, gradient_gain

    def inputs(self, i, world, step):
        x, a, owners = world["x"], world["a"], world["owners"]
        u = [0.0] * len(owners)
        for c in range(len(owners)):
            for j in range(len(x)):
                u[c] -= self.kappa * a[i][j] * (x[i][c] - x[j][c])
        for c, value in zip(own_block(owners, i), world["gradient"](i, x[i]), strict=True):
            u[c] -= self.gradient_gain * value
        return u

    def after(self, world, step):
        """The law has no memory."""


class CorollaryOne(Static):
    """The static law without the time gain: the input over Δt instead of over Θ."""

    def __init__(self, kappa=10.0):
        super().__init__(kappa)

    def inputs(self, i, world, step):
        return [value * step["dt"] / step["theta"] for value in super().inputs(i, world, step)]


class Adaptive:
    """u^i = −R_iᵀ ∂J_i(x^i) − Σ_j κ_ij a_ij (x^i − x^j), κ_ij growing by Θ γ a_ij ‖x^i − x^j‖² per step."""

    def __init__(self, players, gamma=0.01, initial_gain=0.5):
        self.gamma = gamma
        self.kappa = [[initial_gain] * players for _ in range(players)]

    def inputs(self, i, world, step):
        x, a, owners = world["x"], world["a"], world["owners"]
        u = [0.0] * len(owners)
        for c in range(len(owners)):
            for j in range(len(x)):
                u[c] -= self.kappa[i][j] * a[i][j] * (x[i][c] - x[j][c])
        for c, value in zip(own_block(owners, i), world["gradient"](i, x[i]), strict=True):
            u[c] -= value
        return u

    def after(self, world, step):
        x, a = world["x"], world["a"]
        for i in range(len(x)):
            for j in range(len(x)):
                squared = sum((p - q) ** 2 for p, q in zip(x[i], x[j], strict=True))
                self.kappa[i][j] += step["theta"] * self.gamma * a[i][j] * squared


class Grounded:
    """e^i_i = 0; for j ≠ i, e^i_j = −κ [Σ_k a_ik (x^i_j − x^k_j) + a_ij (x^i_j − x^j_j)]."""

    def __init__(self, kappa=2.0):
        self.kappa = kappa

    def inputs(self, i, world, step):
        x, a, owners = world["x"], world["a"], world["owners"]
        u = [0.0] * len(owners)
        for c, j in enumerate(owners):
            if j == i:
                continue
            total = a[i][j] * (x[i][c] - x[j][c])
            for k in range(len(x)):
                total += a[i][k] * (x[i][c] - x[k][c])
            u[c] = -self.kappa * total
        for c, value in zip(own_block(owners, i), world["gradient"](i, x[i]), strict=True):
            u[c] = -value
        return u

    def after(self, world, step):
        """The law has no memory."""


def own_block(owners, i):
    return [c for c, owner in enumerate(owners) if owner == i]


# --- the loop ---------------------------------------------------------------------------------------------------------


def run(*, start, owners, gradient, graph, law, table, input_limit=1000.0):
    """All states x[k][i][c], k = 0..K+H, from the estimates ``start[i][c]``."""
    x = [list(row) for row in start]
    states = [x]
    for step in table:
        world = {"x": x, "a": graph(step), "owners": owners, "gradient": gradient}
        following = []
        for i in range(len(x)):
            u = law.inputs(i, world, step)
            limited = [max(-input_limit, min(input_limit, value)) for value in u]
            following.append([p + step["theta"] * value for p, value in zip(x[i], limited, strict=True)])
        law.after(world, step)
        x = following
        states.append(x)
    return states
