"""Random worlds, random use and the assertions that hold in all of them; for hypothesis (test_fuzz.py) and soak.py.

All randomness comes from a ``random.Random``, which hypothesis can replace. In every session two environments get the
same seeds and actions. The first is used properly. The second is abused in between: wrong calls, which must raise the
documented errors, and writes into every array that it has returned. Both must return the same bits. So an error changes
no state, no returned array is shared, and the same seed and actions give the same episode.
"""

import contextlib
import math
import random
import warnings
from dataclasses import dataclass, fields
from functools import partial

import numpy as np

from ptne_env import FactorySpec, Scenario, VectorParallelEnv, laws, parallel_env
from ptne_env.envs import vector

REFUSALS = (ValueError, RuntimeError)
"""The errors that the library raises at wrong input and wrong calls."""


@dataclass
class Tally:
    """Counts of a session: worlds, and those of them that were refused; episodes and all that happened in them."""

    worlds: int = 0
    refused_worlds: int = 0
    refused_starts: int = 0
    episodes: int = 0
    agent_steps: int = 0
    diverged: int = 0
    clipped: int = 0
    errors: int = 0

    def add(self, other):
        for field in fields(self):
            setattr(self, field.name, getattr(self, field.name) + getattr(other, field.name))

    @property
    def refuses_too_many(self):
        """Whether most worlds were refused; about a third is usual, and a session without a world tests nothing."""
        return self.worlds >= 100 and self.refused_worlds > self.worlds / 2


# Worlds ------------------------------------------------------------------------------------------------------------


def log_uniform(rng, low, high):
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def a_game(rng):
    """The factory spec of a game or a family of games, and its number of players."""

    def numbers(low, high, count):
        return [rng.uniform(low, high) for _ in range(count)]

    def game(name, **arguments):
        return FactorySpec.of(f"game:{name}", **arguments)

    players = rng.randint(2, 6)
    kind = rng.choice(("energy", "energy", "random energy", "random affine", "box", "shipped"))
    if kind == "energy":
        curvature, target = numbers(0.3, 3, players), numbers(-40, 40, players)
        return game("energy", curvature=curvature, target=target, coupling=rng.uniform(0, 0.5)), players
    if kind == "random energy":
        return game("random-energy", players=players), players
    if kind in ("random affine", "box"):
        bounds = {"low": -rng.uniform(1, 20), "high": rng.uniform(1, 20)} if kind == "box" else {}
        shape = {"players": players, "action_dim": rng.randint(1, 3), "asymmetry": rng.uniform(0, 3)}
        return game("random-affine", **shape, **bounds), players
    shipped = {
        "non-quadratic": {"variant": rng.choice(("printed", "corrected"))},
        "cournot": {},
        "oligopoly": {},
        "robots": {},
        "ev-charging": {"limit": rng.uniform(0.5, 3)},
        "rate-control": {},
        "weakly-monotone": {"rotation": rng.uniform(0.1, 2)},
    }
    name = rng.choice(sorted(shipped))
    return game(name, **shipped[name]), 4 if name == "oligopoly" else 5


def some_edges(rng, players):
    """The links of a connected random graph: a random tree and some more."""
    order = rng.sample(range(players), players)
    edges = {tuple(sorted((order[i], order[rng.randrange(i)]))) for i in range(1, players)}
    for _ in range(rng.randint(0, players)):
        edges.add(tuple(sorted(rng.sample(range(players), 2))))
    return sorted(edges)


def adjacency(rng, players, edges):
    matrix = np.zeros((players, players))
    for i, j in edges:
        matrix[i, j] = matrix[j, i] = rng.choice((1.0, rng.uniform(0.2, 2)))
    return matrix


def a_topology(rng, players):
    """The factory spec of a fixed or switching topology of random or named graphs."""

    def graph(name, **arguments):
        return FactorySpec.of(f"ptne_env.world.graphs:{name}", **arguments)

    edges = some_edges(rng, players)
    whole = graph("Graph", adjacency=adjacency(rng, players, edges))
    clock = rng.choice(("physical", "transformed"))
    dwells = sorted(rng.uniform(0.1, 2) for _ in range(2))
    modes = rng.randint(2, 3)
    graphs = [graph("Graph", adjacency=adjacency(rng, players, edges[index::modes])) for index in range(modes)]
    named = rng.choice(("path", "star", "complete", *(["cycle"] if players > 2 else [])))
    kinds = {
        "periodic": {"graphs": graphs, "dwells": [rng.uniform(0.1, 2) for _ in graphs], "clock": clock},
        "random": {"graphs": graphs, "clock": clock, "dwells": dwells[1]},
        "random-edges": {
            "graph": whole,
            "probability": rng.uniform(0.3, 1),
            "dwells": dwells,
            "modes": 8,
            "clock": clock,
        },
        "random-graphs": {"players": players, "probability": rng.uniform(0.5, 1), "modes": rng.randint(2, 5)},
    }
    kind = rng.choice(("whole", "named", *kinds))
    if kind == "whole":
        return whole
    return graph(named, players=players) if kind == "named" else FactorySpec.of(f"topology:{kind}", **kinds[kind])


def a_channel(rng):
    def stage():
        arguments = {
            "AdditiveNoise": {"std": log_uniform(rng, 1e-6, 10)},
            "Delay": {"steps": rng.randint(0, 3), "longest": rng.randint(3, 5)},
            "Loss": {"probability": rng.choice((0.0, rng.random(), 1.0))},
            "BurstLoss": {"to_bad": 0.2, "to_good": rng.uniform(0.1, 1)},
            "UniformQuantiser": {"width": log_uniform(rng, 1e-6, 10)},
            "Lying": {"size": log_uniform(rng, 1e-3, 10)},
        }
        kind = rng.choice(sorted(arguments))
        return FactorySpec.of(f"ptne_env.world.channels:{kind}", **arguments[kind])

    return FactorySpec.of("channel:chain", stages=[stage() for _ in range(rng.randint(1, 3))])


def a_scenario(rng):
    """A scenario of random parts; raises ``ValueError`` if they do not fit together."""
    game, players = a_game(rng)
    reach = log_uniform(rng, 1e-3, 1e5)
    disturbance = {"bound": log_uniform(rng, 1e-3, 100), "dwell": rng.randint(1, 5)}
    return Scenario(
        name="fuzz",
        game=game,
        topology=a_topology(rng, players),
        start=FactorySpec.of("ptne_env.world.starts:UniformStart", low=-reach, high=rng.uniform(0, 1) * reach),
        transformation=rng.choice(("exponential", "exponential", "rational", "tanh")),
        deadline=log_uniform(rng, 0.1, 10),
        gain=rng.choice((0.0, 20.0, log_uniform(rng, 0.1, 50))),
        steps=rng.randint(1, 40),
        s_end=rng.uniform(0.5, 12),
        spacing=rng.choice(("effective", "transformed", "physical")),
        hold_steps=rng.choice((0, 0, rng.randint(1, 6))),
        input_limit=log_uniform(rng, 0.1, 1e6),
        channel=a_channel(rng) if rng.random() < 0.4 else "perfect",
        message_range=rng.uniform(1, 100) if rng.random() < 0.2 else None,
        disturbance=FactorySpec.of("disturbance:uniform", **disturbance) if rng.random() < 0.3 else None,
        slots=rng.choice((None, None, players)),
    )


def some_arguments(rng):
    """Random arguments of an environment: interface, action mode, reward, length."""
    reward = rng.choice(("digits", "tracking", "payoff", "regret", {"digits": 1.0, "tracking": 0.5}, {"payoff": 2.0}))
    return {
        "interface": rng.choice(("physical", "scaled")),
        "reward": reward,
        "max_cycles": rng.choice((None, None, rng.randint(1, 50))),
    }


def a_world(rng):
    """A scenario and arguments with which an environment can be made; raises ``ValueError`` if they do not fit."""
    scenario, arguments = a_scenario(rng), some_arguments(rng)
    parallel_env(scenario, **arguments)
    return scenario, arguments


@contextlib.contextmanager
def no_warnings():
    """Every warning is an error, except that a scenario stops short of its deadline."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*short of the deadline.*")
        yield


# Use ---------------------------------------------------------------------------------------------------------------


def refuses(call, tally):
    """The call raises one of the documented errors, with a message."""
    try:
        call()
    except REFUSALS as error:
        assert str(error).strip(), f"{type(error).__name__} without a message"  # noqa: PT017 - any of several kinds
        tally.errors += 1
    else:
        raise AssertionError("a wrong call was accepted")


def actor(rng, layout):
    """A function from observations (B, N, size) to actions: those of a law, or random ones of some width."""
    generator, bound = np.random.default_rng(rng.getrandbits(32)), layout.action_bound
    if rng.random() < 0.4:
        law = rng.choice((laws.Static, laws.Adaptive, laws.CorollaryOne, laws.Grounded, laws.ZeroInput))
        with contextlib.suppress(ValueError):  # some laws need another interface
            policy, memory = law(layout), [None]

            def decide(observations):
                actions, memory[0] = policy.predict(observations.reshape(-1, layout.size), memory[0])
                assert np.isfinite(actions).all(), f"{law.__name__} returns an action that is not finite"
                assert (np.abs(actions) <= bound).all(), f"{law.__name__} leaves the action box"
                return actions.reshape(*observations.shape[:-1], -1)

            return decide
    width = bound * rng.choice((1e-3, 0.1, 1.0, 1.5)) if rng.random() < 0.8 else rng.choice((0.0, 1e-300, 1e30, 1e300))
    dtype = np.float64 if width > 1e30 else rng.choice((np.float32, np.float64))

    def draw(observations):
        return generator.uniform(-width, width, (*observations.shape[:-1], layout.action_size)).astype(dtype)

    return draw


def arrays(value):
    """All arrays within a returned value."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from arrays(item)
    elif isinstance(value, tuple):
        for item in value:
            yield from arrays(item)


def apart(mine, others):
    """No array shares memory with another one."""
    for index, array in enumerate(mine):
        for other in [*mine[index + 1 :], *others]:
            assert not np.may_share_memory(array, other), "two returned arrays share memory"


def spoil(returned):
    for array in arrays(returned):
        array[...] = np.nan if array.dtype.kind == "f" else 1


def same(first, second, name):
    for one, other in zip(arrays(first), arrays(second), strict=True):
        assert np.array_equal(one, other), f"{name} differ between equal environments"


def within(space, rows):
    assert rows.dtype == space.dtype
    assert np.isfinite(rows).all(), "an observation is not finite"
    assert space.contains(rows.reshape(-1, rows.shape[-1])[0]), "the space does not contain an observation"
    assert ((rows >= space.low) & (rows <= space.high)).all(), "an observation is outside its space"


def vector_env(rng, scenario, count, arguments, block_size):
    usual, vector.BLOCK_SIZE = vector.BLOCK_SIZE, block_size
    try:
        return VectorParallelEnv(scenario, count, **arguments)
    finally:
        vector.BLOCK_SIZE = usual


def wrong_vector_calls(rng, env):
    """Calls that must raise an error and change nothing."""
    shape = (env.num_envs, env.num_players, env.layout.action_size)
    spoilt = np.zeros(shape)
    spoilt.flat[rng.randrange(spoilt.size)] = rng.choice((math.nan, math.inf, -math.inf))
    far = np.zeros((env.num_envs, env.num_players, env.layout.dimension))
    far.flat[rng.randrange(far.size)] = rng.choice((math.nan, -math.inf, 6e5))
    return [
        partial(env.step, spoilt),
        partial(env.step, np.zeros((*shape[:2], shape[2] + 1))),
        partial(env.step, np.zeros(shape[1:])),
        partial(env.step, np.zeros(shape, dtype=bool)),
        partial(env.step, np.zeros(shape).astype(str)),
        partial(env.reset, -1),
        partial(env.reset, 1.5),
        partial(env.reset, [0] * (env.num_envs + 1)),
        partial(env.reset, mask=np.ones(env.num_envs)),
        partial(env.reset, mask=np.ones(env.num_envs + 1, dtype=bool)),
        partial(env.reset, estimates=far),
        partial(env.reset, estimates=far[0, 0]),
        partial(env.reset, estimates=[["x"]]),
    ]


def refused_start(call, abused_call, tally):
    """The result of a reset, or ``None`` if the start is too far out for the game, in both environments."""
    try:
        return call()
    except ValueError as error:
        assert "start closer" in str(error), error  # noqa: PT017 - no other error may occur
        tally.refused_starts += 1
        refuses(abused_call, tally)
        return None


def vector_session(rng, scenario, arguments, tally, episodes):
    """Episodes of a batch; some start again while others continue."""
    count, seed = rng.randint(1, 96), rng.randrange(2**31)
    env = vector_env(rng, scenario, count, arguments, 2048)
    abused = vector_env(rng, scenario, count, arguments, rng.choice((3, 2048)))
    early = partial(abused.step, np.zeros((count, env.num_players, env.layout.action_size)))
    refuses(early, tally)  # before the first reset
    started = refused_start(partial(env.reset, seed), partial(abused.reset, seed), tally)
    if started is None:
        return
    observations, _ = started
    spoil(abused.reset(seed)[0])
    over, wanted, length = np.zeros(count, dtype=bool), tally.episodes + episodes, np.zeros(count, dtype=int)
    decide, kept = actor(rng, env.layout), []
    while tally.episodes < wanted:
        within(env.single_observation_space, observations)
        if over.all() or (over.any() and rng.random() < 0.5):  # a reset between steps, else within the step
            refuses(early, tally)
            started = refused_start(partial(env.reset, mask=over), partial(abused.reset, mask=over), tally)
            if started is None:
                return
            observations, _ = started
            same((observations,), abused.reset(mask=over)[:1], "first observations")
            length[over], over = 0, np.zeros(count, dtype=bool)
            decide = actor(rng, env.layout)
            continue
        actions, restart = decide(observations), over
        outcome = env.step(actions, restart.copy() if restart.any() else None)
        for wrong in rng.sample(wrong_vector_calls(rng, abused), 2 if rng.random() < 0.3 else 0):
            refuses(wrong, tally)
        repeated = abused.step(actions.copy(), restart.copy() if restart.any() else None)
        same(outcome, repeated, "steps")
        returned = list(arrays(repeated))
        apart(returned, [*kept, actions])
        spoil(repeated)
        kept, observations = returned, outcome.observations
        length = np.where(restart, 0, length + 1)
        check_outcome(env, outcome, actions, length)
        over = outcome.terminated | outcome.truncated
        tally.episodes += int(over.sum())
        tally.diverged += int((outcome.infos["diverged"] & over).sum())
        tally.agent_steps += int((~restart).sum()) * env.num_players
        tally.clipped += int(outcome.infos["clipped"].sum())


def check_outcome(env, outcome, actions, length):
    """All results of a step of a batch are finite, and episodes end at the right step."""
    infos, terminated, truncated = outcome.infos, outcome.terminated, outcome.truncated
    assert np.isfinite(outcome.rewards).all(), "a reward is not finite"
    assert all(np.isfinite(infos[name]).all() for name in env.reward_names), "a reward term is not finite"
    moved = length > 0
    outside = (np.abs(actions) > env.layout.action_bound).sum(axis=2)
    assert (infos["clipped"] == outside * moved[:, None]).all(), "clipped entries are counted wrongly"
    ends = length >= env.scenario.steps + env.scenario.hold_steps
    cut = length >= (env.max_cycles or math.inf)
    assert (terminated == (moved & (ends | infos["diverged"]))).all(), "an episode ends at another step"
    assert (truncated == (moved & cut & ~terminated)).all(), "an episode is cut at another step"
    assert not (infos["is_success"] & infos["diverged"]).any(), "success is reported without any"


def session(rng, episodes):
    """The tally of one random world and all its use.

    Raises:
        AssertionError: when an assertion does not hold; any other exception is a fault of the library, too.
    """
    tally = Tally(worlds=1)
    with no_warnings():
        try:
            scenario, arguments = a_world(rng)
        except ValueError as error:  # parts that do not fit together
            assert str(error).strip()  # noqa: PT017 - the message is the assertion
            tally.refused_worlds += 1
            return tally
        assert Scenario.from_dict(scenario.to_dict()) == scenario
        vector_session(rng, scenario, arguments, tally, episodes)
    return tally


def play(seed, episodes):
    """:func:`session` from a seed."""
    return session(random.Random(seed), episodes)  # noqa: S311 - worlds, not secrets
