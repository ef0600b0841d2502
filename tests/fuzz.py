"""Random worlds, random use and the assertions that hold in all of them; for test_fuzz.py and soak.py.

All randomness comes from a ``random.Random``. In every session two environments get the
same seeds and actions. The first is used properly. The second is abused in between: wrong calls, which must raise the
documented errors, and writes into every array that it has returned. Both must return the same bits. So an error changes
no state, no returned array is shared, and the same seed and actions give the same episode.
"""

import contextlib
import math
import random
import re
import warnings
from collections import Counter
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from sample_games import crowded_costs, excess

from ptne_env import FactorySpec, Scenario, VectorParallelEnv, parallel_env
from ptne_env.envs import vector
from ptne_env.perception.observation import LayoutError
from ptne_env.shared.parts import PARTS
from ptne_env.world.rewards import TERMS

REFUSALS = (ValueError, RuntimeError)
"""The errors that the library raises at wrong input and wrong calls."""


UNPLAYABLE = {
    "game:market-118": "no random graph has 54 players; its track is compared and played elsewhere",
    "topology:market-118": "likewise",
    "law:oracle": "its interface is full, which environments refuse",
    "policy:file": "it needs a file",
    "suite:ptne-v1": "a suite is no part of a scenario",
    "suite:robustness": "likewise",
}
"""Parts that no session plays, and why."""


@dataclass
class Tally:
    """Counts of a session: worlds, and those of them that were refused; episodes and all that happened in them.

    ``parts`` counts the worlds in which each part of the library was played.
    """

    worlds: int = 0
    refused_worlds: int = 0
    refused_starts: int = 0
    episodes: int = 0
    agent_steps: int = 0
    diverged: int = 0
    clipped: int = 0
    errors: int = 0
    parts: Counter = field(default_factory=Counter)

    def add(self, other):
        for name in vars(self):
            setattr(self, name, getattr(self, name) + getattr(other, name))

    @property
    def refuses_too_many(self):
        """Whether most worlds were refused; about a third is usual, and a session without a world tests nothing."""
        return self.worlds >= 100 and self.refused_worlds > self.worlds / 2

    @property
    def unplayed(self):
        """The parts of the library that no world has played."""
        return [name for name in PARTS if not (name in self.parts or name in UNPLAYABLE)]


# Worlds ------------------------------------------------------------------------------------------------------------

DOES_NOT_FIT = (
    "the shortest dwell, .*, is shorter than the longest step",
    "the game has . players, the graphs .; pass a topology",
    "the paper's start is for one component per player, the game has",
    "reward 'regret' needs a best response",
    "^players must be a whole number of at least 3, got 2",
    "^own gradients at the initial estimates must be within .*: start closer",
)
"""Reasons for which a random scenario may be refused. Any other error is a fault, such as that of an argument which a
part does not have."""


def fitting(draw):
    """What ``draw()`` returns; ``None`` where it is refused for one of the reasons."""
    try:
        return draw()
    except ValueError as error:
        if not any(re.search(reason, str(error)) for reason in DOES_NOT_FIT):
            raise
        return None


def names_of(kind):
    """The names of the library's parts of a kind that sessions play."""
    return [name.partition(":")[2] for name in PARTS if name.startswith(f"{kind}:") and name not in UNPLAYABLE]


def log_uniform(rng, low, high):
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def numbers(rng, low, high, *shape):
    """A list, or a table, of random numbers."""
    return [numbers(rng, low, high, *shape[1:]) for _ in range(shape[0])] if shape else rng.uniform(low, high)


def part(name, **arguments):
    return FactorySpec.of(name, **arguments)


def affine_arguments(rng, players):
    """A matrix with a positive definite symmetric part, and an offset."""
    matrix = np.array(numbers(rng, -1, 1, players, players))
    return {"matrix": matrix + players * np.eye(players), "offset": numbers(rng, -40, 40, players)}


def random_affine_arguments(rng, players, box=0.3):
    bounds = {"low": -rng.uniform(1, 20), "high": rng.uniform(1, 20)} if rng.random() < box else {}
    return {"players": players, "action_dim": rng.randint(1, 3), "asymmetry": rng.uniform(0, 3), **bounds}


def energy_arguments(rng, players):
    curvature, target = numbers(rng, 0.3, 3, players), numbers(rng, -40, 40, players)
    return {"curvature": curvature, "target": target, "coupling": rng.uniform(0, 0.5)}


def market_arguments(rng, players):
    quadratic, linear, high = (numbers(rng, low, high, players) for low, high in ((0, 2), (-9, 9), (1, 40)))
    return {"quadratic": quadratic, "linear": linear, "intercept": 20.0, "slope": rng.uniform(0.1, 1), "high": high}


def priced_arguments(rng, players):
    constraint = numbers(rng, -1, 1, 2, players)
    return {"game": part("game:quadratic", **affine_arguments(rng, players)), "constraint": constraint, "limit": [1, 2]}


def costs_arguments(rng, players):
    bounds = {"low": -rng.uniform(1, 20), "high": rng.uniform(1, 20)} if rng.random() < 0.5 else {}
    return {"function": crowded_costs, "action_dims": [1] * players, **bounds}


def saturating_arguments(rng, players):
    prices, shift = numbers(rng, -1, 1, 2, players), numbers(rng, -1, 1, 2)
    equilibrium = numbers(rng, -9, 9, players)
    matrix = affine_arguments(rng, players)["matrix"]
    return {"matrix": matrix, "prices": prices, "shift": shift, "equilibrium": equilibrium}


def whole_family(rng, players):
    """A family of affine games without bounds."""
    return part("game:random-affine", **random_affine_arguments(rng, players, box=0))


GAMES = {
    "costs": costs_arguments,
    "coupled": lambda rng, players: {"game": whole_family(rng, players), "lines": rng.randint(1, 2)},
    "energy": energy_arguments,
    "market": market_arguments,
    "non-quadratic": lambda rng, _: {"variant": rng.choice(("printed", "corrected"))},
    "priced": priced_arguments,
    "priced-costs": lambda rng, players: {
        "game": part("game:costs", **costs_arguments(rng, players)),
        "constraint": excess,
    },
    "quadratic": affine_arguments,
    "random-affine": random_affine_arguments,
    "random-energy": lambda _, players: {"players": players},
    "random-saturating": lambda rng, players: {"affine": whole_family(rng, players), "bend": rng.uniform(0, 3)},
    "saturating": saturating_arguments,
}
"""By name, random arguments of games of some number of players, for those that have arguments."""


def some_edges(rng, players):
    """The links of a connected random graph: a random tree and some more."""
    order = rng.sample(range(players), players)
    edges = {tuple(sorted((order[i], order[rng.randrange(i)]))) for i in range(1, players)}
    for _ in range(rng.randint(0, players)):
        edges.add(tuple(sorted(rng.sample(range(players), 2))))
    return sorted(edges)


def adjacency(rng, players, edges):
    """Weights of these links; in some graphs they depend on the direction, and one more link has only one."""
    matrix, is_directed = np.zeros((players, players)), rng.random() < 0.3
    for i, j in edges:
        matrix[i, j] = matrix[j, i] = rng.choice((1.0, rng.uniform(0.2, 2)))
        matrix[j, i] *= rng.choice((1.0, rng.uniform(0.2, 2))) if is_directed else 1.0
    if is_directed:
        matrix[tuple(rng.sample(range(players), 2))] = 1.0
    return matrix


def a_graph(rng, players):
    return part("topology:graph", adjacency=adjacency(rng, players, some_edges(rng, players)))


def some_modes(rng, players):
    """Graphs that are connected together, and perhaps not alone."""
    edges, modes = some_edges(rng, players), rng.randint(2, 3)
    return [part("topology:graph", adjacency=adjacency(rng, players, edges[mode::modes])) for mode in range(modes)]


def periodic_arguments(rng, players):
    graphs = some_modes(rng, players)
    return {"graphs": graphs, "dwells": numbers(rng, 0.1, 2, len(graphs)), "clock": a_clock(rng)}


def random_edges_arguments(rng, players):
    dwells = sorted(numbers(rng, 0.1, 2, 2))
    chances = {"probability": rng.uniform(0.5, 1), "modes": 16}  # so that every link is up in some mode
    return {"graph": a_graph(rng, players), "dwells": dwells, "clock": a_clock(rng), **chances}


def a_clock(rng):
    return rng.choice(("physical", "transformed"))


def of_players(_, players):
    return {"players": players}


TOPOLOGIES = {
    "circulant": lambda rng, players: {"players": players, "offsets": [1, rng.randint(1, players // 2)]},
    "complete": of_players,
    "cycle": of_players,
    "edges": lambda rng, players: {"players": players, "edges": some_edges(rng, players)},
    "episode": lambda rng, players: {"graphs": [a_graph(rng, players) for _ in range(3)]},
    "graph": lambda rng, players: {"adjacency": adjacency(rng, players, some_edges(rng, players))},
    "paper": lambda rng, _: {"dwell": rng.uniform(0.1, 2), "clock": a_clock(rng)},
    "path": of_players,
    "periodic": periodic_arguments,
    "random": lambda rng, players: {
        "graphs": some_modes(rng, players),
        "dwells": rng.uniform(0.1, 2),
        "clock": a_clock(rng),
    },
    "random-edges": random_edges_arguments,
    "random-graphs": lambda rng, players: {
        "players": players,
        "probability": rng.uniform(0.5, 1),
        "modes": rng.randint(2, 5),
    },
    "star": of_players,
}
"""By name, random arguments of topologies on some number of players."""

STAGES = {
    "bias": lambda rng: {"bound": log_uniform(rng, 1e-3, 10)},
    "bursts": lambda rng: {"to_bad": 0.2, "to_good": rng.uniform(0.1, 1)},
    "delay": lambda rng: {"steps": rng.randint(0, 3), "longest": rng.randint(3, 5)},
    "heavy-tails": lambda rng: {"scale": log_uniform(rng, 1e-3, 10)},
    "late-noise": lambda rng: {"std": log_uniform(rng, 1e-3, 10), "step": rng.randint(0, 20)},
    "liar": lambda rng: {"size": log_uniform(rng, 1e-3, 10)},
    "loss": lambda rng: {"probability": rng.choice((0.0, rng.random(), 1.0))},
    "noise": lambda rng: {"std": log_uniform(rng, 1e-3, 10)},
    "rounding": lambda rng: {"width": log_uniform(rng, 1e-3, 10)},
}
"""By name, random arguments of the stages of a chain of channels."""


def chain_arguments(rng):
    names = [name for name in names_of("channel") if name not in ("chain", "perfect")]
    return {"stages": [a_part(rng, "channel", rng.choice(names)) for _ in range(rng.randint(1, 3))]}


def reach_of(rng):
    return log_uniform(rng, 1e-3, 1e5)


STARTS = {
    "fixed": lambda rng, game: {
        "estimates": numbers(rng, *sorted((0, reach_of(rng))), game.num_players, game.dimension)
    },
    "uniform": lambda rng, _: {"low": -(reach := reach_of(rng)), "high": rng.uniform(0, 1) * reach},
}
"""By name, random arguments of starts of a game."""

DISTURBANCES = {"uniform": lambda rng: {"bound": log_uniform(rng, 1e-3, 100), "dwell": rng.randint(1, 5)}}
KINDS = {
    "game": GAMES,
    "topology": TOPOLOGIES,
    "start": STARTS,
    "channel": {"chain": chain_arguments, **STAGES},
    "disturbance": DISTURBANCES,
    "transformation": {},
}
"""Random arguments of the parts of a scenario, by kind and name. A part that is not here is made without arguments."""


def a_part(rng, kind, name, *context):
    """A part with random arguments."""
    arguments = KINDS[kind].get(name)
    return part(f"{kind}:{name}", **(arguments(rng, *context) if arguments else {}))


def a_scenario(rng, **names):
    """A scenario of random parts, of some kinds those of ``names``; ``ValueError`` if they do not fit together."""

    def name_of(kind, *weights):
        return names.get(kind) or rng.choice((*names_of(kind), *weights))

    game = a_part(rng, "game", name_of("game", "energy", "energy"), rng.randint(2, 6))
    made = game.build()
    made = getattr(made, "representative", made)
    gain = rng.choice((0.0, 20.0, log_uniform(rng, 0.1, 50)))
    channel = names.get("channel") or ("chain" if rng.random() < 0.4 else "perfect")
    disturbance = name_of("disturbance") if "disturbance" in names or rng.random() < 0.3 else None
    return Scenario(
        name="fuzz",
        game=game,
        topology=a_part(rng, "topology", name_of("topology"), made.num_players),
        start=a_part(rng, "start", name_of("start", *["uniform"] * 9), made),
        transformation=f"transformation:{name_of('transformation', 'exponential')}",
        deadline=log_uniform(rng, 0.1, 10),
        gain=gain,
        steps=rng.randint(1, 40),
        s_end=rng.uniform(0.5, 12),
        spacing=rng.choice(("effective", "transformed", "physical")),
        hold_steps=rng.choice((0, 0, rng.randint(1, 6))) if gain else 0,
        input_limit=log_uniform(rng, 0.1, 1e6),
        channel=a_part(rng, "channel", channel),
        message_range=rng.uniform(1, 100) if rng.random() < 0.2 else None,
        disturbance=disturbance and a_part(rng, "disturbance", disturbance),
        slots=rng.choice((None, None, made.num_players)),
    )


def some_arguments(rng):
    """Random arguments of an environment: interface, action mode, reward, length."""
    names = sorted(TERMS)
    weights = {name: rng.choice((1.0, 0.5)) for name in rng.sample(names, 2)}
    return {
        "interface": rng.choice(("physical", "physical", "scaled")),
        "reward": rng.choice((*names, "digits", weights)),
        "max_cycles": rng.choice((None, None, rng.randint(1, 50))),
    }


def a_world(rng, **names):
    """A scenario and arguments with which an environment can be made; ``None`` if they do not fit together."""

    def draw():
        scenario, arguments = a_scenario(rng, **names), some_arguments(rng)
        parallel_env(scenario, **arguments)
        return scenario, arguments

    return fitting(draw)


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


def actor(rng, layout, tally, law=None):
    """A function from observations (B, N, size) to actions: those of a law, or random ones of some width."""
    generator, bound = np.random.default_rng(rng.getrandbits(32)), layout.action_bound
    if law or rng.random() < 0.7:
        law = f"law:{law or rng.choice(names_of('law'))}"
        with contextlib.suppress(LayoutError):  # some laws need another interface, or a fixed graph
            wrapped = {"policy": FactorySpec.of("law:relay")} if law == "law:coded" else {}
            policy, memory = FactorySpec.of(law, **wrapped).build(layout=layout), [None]
            tally.parts[law] += 1

            def decide(observations):
                actions, memory[0] = policy.predict(observations.reshape(-1, layout.size), memory[0])
                assert np.isfinite(actions).all(), f"{law} returns an action that is not finite"
                assert (np.abs(actions) <= bound).all(), f"{law} leaves the action box"
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


def vector_session(rng, scenario, arguments, tally, episodes, law=None):
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
    decide, kept = actor(rng, env.layout, tally, law), []
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
            decide = actor(rng, env.layout, tally, law)
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


def session(rng, episodes, **names):
    """The tally of one random world and all its use; of some kinds the parts are those of ``names``.

    Raises:
        AssertionError: when an assertion does not hold; any other exception is a fault of the library, too.
    """
    tally = Tally(worlds=1)
    with no_warnings():
        world = a_world(rng, **names)
        if world is None:
            tally.refused_worlds += 1
            return tally
        scenario, arguments = world
        assert Scenario.from_dict(scenario.to_dict()) == scenario
        vector_session(rng, scenario, arguments, tally, episodes, names.get("law"))
        if tally.episodes:
            tally.parts.update({name for name in re.findall(r"\w+:[\w-]+", str(scenario.to_dict())) if name in PARTS})
    return tally


def play(seed, episodes, **names):
    """:func:`session` from a seed."""
    return session(random.Random(seed), episodes, **names)  # noqa: S311 - worlds, not secrets
