"""Scenarios, oracles and loops that several tests share."""

import numpy as np
import pytest

import ptne_env
from ptne_env import CATALOGUE, FactorySpec, Interface, Scenario
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.fields import FIELDS, Field
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.world import World


def quantity(world, state, name):
    """A field of a state, or a quantity that a function of ``dynamics`` computes from it, by name."""
    if name in State._fields:
        return getattr(state, name)
    if name == "strategies":
        return dynamics.strategies(state)
    if name == "messages":
        return dynamics.sent_messages(world, state.estimates) if state.received is None else state.received.messages
    return getattr(dynamics, name)(world, state)


FROM_THE_PAPER = list(CATALOGUE)[:6]
"""The scenarios of the catalogue that play the paper's games, as do the tests here from the paper's start."""

PAPER_START = np.array(
    [
        [-2.0, 15.0, 10.0, 5.0, 0.0],
        [15.0, -4.0, 10.0, 5.0, 0.0],
        [15.0, 10.0, -6.0, 5.0, 0.0],
        [15.0, 10.0, 5.0, -8.0, 0.0],
        [15.0, 10.0, 5.0, 0.0, -10.0],
    ]
)
"""Row i is x^i(0), typed from the paper."""

BLOCKS = Scenario(
    name="blocks",
    game=FactorySpec.of("sample_games:BlockGame", action_dims=(2, 1, 3)),
    topology=FactorySpec.of("ptne_env.world.graphs:path", players=3),
    start="random",
)
"""Players of 2, 1 and 3 dimensions on a path."""

BLOCKS_SWITCHING = BLOCKS.replace(
    name="blocks-switching",
    topology=FactorySpec.of(
        "topology:periodic",
        graphs=(
            FactorySpec.of("ptne_env.world.graphs:from_edges", players=3, edges=((0, 1),)),
            FactorySpec.of("ptne_env.world.graphs:from_edges", players=3, edges=((1, 2),)),
        ),
        dwells=(0.3, 0.5),
        clock="transformed",
    ),
)


def channel_part(kind, **arguments):
    """The part that builds a stage of a channel."""
    return FactorySpec.of(f"ptne_env.world.channels:{kind}", **arguments)


EVERY_FAULT = channel_part(
    "Chain",
    stages=(
        channel_part("UniformQuantiser", width=0.01),
        channel_part("AdditiveNoise", std=0.1),
        channel_part("Loss", probability=0.2),
        channel_part("Delay", steps=0, longest=3),
        channel_part(
            "Chain",
            stages=(channel_part("BurstLoss", to_bad=0.1, to_good=0.4), channel_part("UniformQuantiser", width=0.03)),
        ),
    ),
)
"""A channel of all stages."""

FAULTY = CATALOGUE["random-energy"].replace(
    name="faulty",
    topology=FactorySpec.of(
        "ptne_env.world.switching:random_edges",
        graph=FactorySpec.of("ptne_env.world.graphs:cycle", players=5),
        probability=0.6,
        dwells=(0.3, 0.5),
        clock="transformed",
    ),
    gain=2.0,
    steps=60,
    hold_steps=4,
    channel=EVERY_FAULT,
    disturbance=FactorySpec.of("disturbance:uniform", bound=3.0, dwell=2),
    slots=4,
)
"""Everything that can go wrong."""


def energy_scenario(curvature, target, topology, **fields):
    """The energy game with these players, on any topology, from random estimates."""
    game = FactorySpec.of("ptne_env.games:EnergyGame", curvature=curvature, target=target)
    return Scenario(name="energy-variant", game=game, topology=topology, **{"start": "random", **fields})


DIRECTED = CATALOGUE["energy"].replace(
    name="directed",
    topology=[[0, 0, 0, 0, 2.0], [0.5, 0, 1, 0, 0], [0, 1, 0, 0, 0], [0, 0, 1.5, 0, 0], [0, 0, 0, 1, 0]],
)
"""The energy game on a directed ring of several weights, with one link that carries messages in both directions."""


def fixed_part(adjacency):
    """The part that builds the fixed topology of an adjacency matrix."""
    return FactorySpec.of("ptne_env.world.graphs:Graph", adjacency=adjacency)


def loop_matrix(game, adjacency, kappa, gradient_gain=1.0):
    """M = Rᵀ dF + κ L⊗I of an affine game, acting on col(x^1 … x^N)."""
    n = game.dimension
    jacobian = game.jacobian(np.zeros((n, 1)))[:, :, 0]
    adjacency = np.asarray(adjacency)
    laplacian = np.diag(adjacency.sum(axis=1)) - adjacency
    matrix = kappa * np.kron(laplacian, np.eye(n))
    for component, owner in enumerate(game.owners):
        matrix[owner * n + component, owner * n : (owner + 1) * n] += gradient_gain * jacobian[component]
    return matrix


def begin(world, seeds):
    """The state at t = 0 that these seeds draw, game and estimates, one environment each."""
    sources = [RandomStreams.from_seed(seed) for seed in seeds]
    estimates, game = world.draw_estimates(sources), world.draw_game(sources)
    return dynamics.initial_state(world, estimates, game, world.draw_randomness(sources))


def stack(estimates):
    """(n, N, B) of one environment to col(x^1 … x^N)."""
    return estimates[:, :, 0].T.ravel()


def while_running(env):
    """The number of each step of the episode; one that never ends fails instead of hanging."""
    for step in range(env.world.clock.total_steps + 1):
        if not env.agents:
            return
        yield step
    raise AssertionError("the episode goes on after its last step")


def play(env, policy, **reset):
    """Run one episode; all estimates (K+1, N, n), and what each step returned."""
    observations, _ = env.reset(**reset)
    memory, states, steps = None, [env.estimates], []
    for _ in while_running(env):
        agents = list(env.agents)
        actions, memory = policy.predict(np.stack([observations[agent] for agent in agents]), state=memory)
        result = env.step(dict(zip(agents, actions, strict=True)))
        observations = result[0]
        states.append(env.estimates)
        steps.append(result)
    return np.array(states), steps


def constant_actions(env, value):
    """The same action in every entry, for every live agent."""
    size = env.layout.action_size
    return {agent: np.full(size, value, dtype=np.float32) for agent in env.agents}


def from_the_paper(scenario):
    """A scenario; that of a name in :data:`FROM_THE_PAPER` from the paper's start."""
    return ptne_env.get_scenario(scenario, **({"start": "paper"} if scenario in FROM_THE_PAPER else {}))


def make_env(scenario, **arguments):
    """The environment of a scenario, or of a name and then from the paper's start; in natural units by default."""
    return ptne_env.parallel_env(from_the_paper(scenario), **{"interface": "physical", **arguments})


def world_and_encoder(scenario, kind="physical"):
    """A world, of a name from the paper's start, and its encoder, of an interface or of a name of one."""
    world = World(from_the_paper(scenario))
    return world, Encoder(world, kind)


DEGREE = Field(
    "degree", "1", lambda view: (view.weights > 0).sum(0)[None], "live links", lambda layout: (0, layout.slots)
)
OWN_COST = Field("own_cost", "1", lambda view: view.state.game.costs(dynamics.strategies(view.state))[None], "$J_i(x)$")
"""Fields that the library lacks."""


def with_field(name, units):
    """The interface of these units that has a field besides the default ones."""
    return Interface(units, fields=(*Interface(units).fields, name))


def every_field():
    """Each field of the observation in each of the units in which it is available, as an interface."""
    return [
        pytest.param(name, with_field(name, units), id=f"{name}-{units}")
        for name, field in FIELDS.items()
        for units in sorted({Interface(kind).units for kind in field.kinds or ("scaled", "physical")})
    ]


def whole_interface(units):
    """The interface of these units that has every field which is available in them."""
    return Interface(units, fields=tuple(case.values[0] for case in every_field() if case.values[1].units == units))


def large_energy_scenario(players=11, **fields):
    """So many players that a sum over them may be taken in more than one order."""
    generator = np.random.default_rng(8)
    return Scenario(
        name="large",
        game=FactorySpec.of(
            "ptne_env.games:EnergyGame",
            curvature=generator.uniform(0.5, 2, players),
            target=generator.uniform(5, 30, players),
        ),
        topology=FactorySpec.of("ptne_env.world.graphs:cycle", players=players),
        start="random",
        **fields,
    )


SHORT = {"steps": 6, "start": "random", "input_limit": 5.0}
"""Arguments of environments with short episodes."""


def random_actions(env, generator):
    bound = 1.2 * env.layout.action_bound
    shape = (env.num_envs, env.num_players, env.layout.action_size)
    return generator.uniform(-bound, bound, shape).astype(np.float32)
