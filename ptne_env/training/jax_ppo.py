"""PPO compiled with the world, by a network that all players share: ``ippo``, ``ippo-rnn`` and ``mappo-rnn``.

Independent learners (C. Schroeder de Witt et al., arXiv:2011.09533), feed-forward or with a gated recurrent unit, and
multi-agent PPO (C. Yu et al., arXiv:2103.01955), whose critic sees the state. Critics read what the actor remembers
instead of having a memory of their own, which is faster. Everything from rollout to update is one ``lax.scan``,
as in PureJaxRL and JaxMARL. A run is resumed bit for bit, so that it ends as if nothing had happened.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

import ptne_env.jax
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.tracks import find_track
from ptne_env.learn.layers import (
    Metadata,
    Weights,
    is_recurrent,
    read_in,
    read_out,
    run_layers,
    update_hidden,
    weight_shapes,
)
from ptne_env.learn.npz_policy import seal
from ptne_env.perception.fields import LOG_SCALE_UNIT
from ptne_env.training.configuration import (
    Configuration,
    RunSummary,
    read_checkpoint,
    read_finished_run,
    write_checkpoint,
    write_record,
)
from ptne_env.training.curve import CURVE_EPISODES, finish, write_learning_curve
from ptne_env.training.team import Team
from ptne_env.world.dynamics import State

EVALUATIONS = 20
"""The number of evaluations, and of checkpoints, in a run."""

CLIP, LARGEST_RATIO, GAE_LAMBDA, VALUE_WEIGHT, LARGEST_NORM = 0.2, 3.0, 0.9, 0.5, 0.5
"""What is not tuned: ε; the ratio of probabilities above which bad actions have no slope either (dual-clip PPO, D. Ye
et al., arXiv:1912.09729); λ; the weight of the value's loss; and the norm to which gradients are cut."""

AVERAGED_UPDATES, SCALE_DECAY = 50, 0.95
"""The updates over which weights are averaged; and the decay per update of the running unit of returns."""


class Runner(NamedTuple):
    """All that goes on from update to update.

    Attributes:
        params: the weights of ``actor`` and ``critic``, and ``log_std`` of the actions (n,).
        optimiser: the moments of Adam.
        average: the running mean of the actor's weights, which is evaluated and exported.
        state: the environments.
        memory: what players remember, (units, M).
        starts: whether a player's episode has just begun, (M,).
        scale: the standard deviation of returns, by which rewards are divided.
        done: the number of updates.
    """

    params: dict[str, Any]
    optimiser: Any
    average: Weights
    state: State
    memory: Any
    starts: Any
    scale: Any
    done: Any


class Steps(NamedTuple):
    """Steps of M players, environments last: (size, M) and (M,), or with an axis of T steps before them all."""

    observations: Any
    state_seen: Any
    starts: Any
    values: Any
    actions: Any = None
    log_probabilities: Any = None
    rewards: Any = None
    overs: Any = None


class Learner:
    """The compiled functions of a training."""

    def __init__(self, configuration: Configuration) -> None:
        self.configuration = configuration
        self.track = find_track(configuration.scenario)
        self.world = ptne_env.jax.JaxWorld(self.track.scenario, seed=configuration.seed)
        self.layout, self.team = self.world.layout, Team(self.track, self.world)
        self.players = self.team.learners
        self.envs = configuration.environments(len(self.players))
        self.members = self.envs * len(self.players)
        self.is_recurrent = configuration.algorithm.endswith("-rnn")
        self.sees_state = configuration.algorithm.startswith("mappo")
        self.columns = self.members * (1 if self.is_recurrent else configuration.rollout)
        if self.columns < configuration.minibatches:
            what = "players of all environments" if self.is_recurrent else "samples of a rollout"
            raise ValueError(f"minibatches must be at most the {self.columns} {what}, got {configuration.minibatches}")
        updates = -(-configuration.steps // (configuration.rollout * self.members))
        self.updates_per_chunk = -(-updates // EVALUATIONS)
        self.chunks = -(-updates // self.updates_per_chunk)
        total = self.chunks * self.updates_per_chunk * configuration.epochs * configuration.minibatches
        rate = optax.cosine_decay_schedule(configuration.learning_rate, total)
        self.optimiser = optax.chain(optax.clip_by_global_norm(LARGEST_NORM), optax.adam(rate, eps=1e-5))
        self.validation = self.world.state(
            EpisodeSet(CURVE_EPISODES, split="validation").initial_state(self.world.numpy)
        )
        self.start, self.evaluate = jax.jit(self._start), jax.jit(self._evaluate)
        self.train_chunk = jax.jit(lambda runner: jax.lax.scan(self._update, runner, length=self.updates_per_chunk)[0])

    def _start(self) -> Runner:
        """Return the runner before the first update."""
        configuration, layout = self.configuration, self.layout
        of_actor, of_critic, of_episodes = jax.random.split(jax.random.key(configuration.seed), 3)
        units = configuration.hidden[-1] if self.is_recurrent else 0
        size = layout.size + self.sees_state * (layout.dimension + layout.num_players) + units
        shapes = weight_shapes(layout.size, configuration.hidden, layout.action_size, recurrent=self.is_recurrent)
        actor = _draw_weights(of_actor, shapes, 0.01)
        params = {
            "actor": actor,
            "critic": _draw_weights(of_critic, weight_shapes(size, configuration.hidden, 1, recurrent=False), 1.0),
            "log_std": jnp.full((layout.action_size, 1), configuration.log_std, jnp.float32),
        }
        memory = jnp.zeros((units, self.members), jnp.float32)
        state = self.world.reset(of_episodes, self.envs)
        starts, one = jnp.ones(self.members, bool), jnp.ones((), jnp.float32)
        return Runner(params, self.optimiser.init(params), actor, state, memory, starts, one, jnp.zeros((), int))

    def _update(self, runner: Runner, _: None = None) -> tuple[Runner, None]:
        """Play a rollout, and learn from it."""
        configuration = self.configuration
        key = jax.random.fold_in(jax.random.key(configuration.seed), runner.done)
        of_steps, of_batches = jax.random.split(key)
        keys = jax.random.split(of_steps, configuration.rollout)
        after, steps = jax.lax.scan(self._step, runner, keys)
        last, _, _ = self._look(after)
        advantages = self._advantages(steps, last.values, runner.scale)
        returns = advantages + steps.values
        # Sequences of players, or single samples where nothing is remembered, are shuffled into minibatches: (C, T, …).
        batch = [each.reshape(configuration.rollout, -1, self.members) for each in (*steps, advantages, returns)]
        length = configuration.rollout if self.is_recurrent else 1
        batch = [jnp.moveaxis(each, -1, 0).reshape(self.columns, length, each.shape[1]) for each in batch]

        def learn(carry: Any, chosen: Any) -> tuple[Any, None]:
            params, optimiser = carry
            parts = [jnp.moveaxis(each[chosen], 0, -1) for each in batch]  # (T, …, C)
            memory = runner.memory[:, chosen] if self.is_recurrent else None
            slope = jax.grad(self._loss)(params, Steps(*parts[:-2]), *parts[-2:], memory)
            change, optimiser = self.optimiser.update(slope, optimiser, params)
            return (optax.apply_updates(params, change), optimiser), None

        keys = jax.random.split(of_batches, configuration.epochs)
        whole = self.columns - self.columns % configuration.minibatches  # an epoch leaves out the samples of a rest
        orders = jnp.concatenate([jax.random.permutation(key, self.columns)[:whole] for key in keys])
        orders = orders.reshape(configuration.epochs * configuration.minibatches, -1)
        (params, optimiser), _ = jax.lax.scan(learn, (runner.params, runner.optimiser), orders)
        share = 1 / jnp.minimum(runner.done + 1, AVERAGED_UPDATES).astype(jnp.float32)
        average = jax.tree.map(lambda old, new: old + share * (new - old), runner.average, params["actor"])
        unit = (returns * runner.scale).std()
        scale = jnp.where(runner.done == 0, unit, SCALE_DECAY * runner.scale + (1 - SCALE_DECAY) * unit)
        done = runner.done + 1
        return after._replace(params=params, optimiser=optimiser, average=average, scale=scale, done=done), None

    def _look(self, runner: Runner) -> tuple[Steps, Any, Any]:
        """Return what players see, with their values, the means of their actions, and what they remember."""
        observations = self._observe(runner.state)
        seen = self._state_seen(runner.state, observations) if self.sees_state else observations[:0]
        memory = jnp.where(runner.starts, 0, runner.memory)
        means, memory = run_layers(runner.params["actor"], observations, memory)
        values, _ = run_layers(runner.params["critic"], _critic_sees(observations, seen, memory), None)
        return Steps(observations, seen, runner.starts, values[0]), means, memory

    def _observe(self, state: State) -> Any:
        """Return the observations of the players that learn, (size, M)."""
        return self.world.observe(state)[:, self.players].reshape(self.layout.size, -1)

    def _state_seen(self, state: State, observations: Any) -> Any:
        """Return what a critic of the state sees beside the observation, in ego order and of order one, (n + N, M).

        It is the way to the equilibrium in units of σ_i, and the logarithm of the distance of each player to it.
        """
        errors, players = state.game.nash_equilibria[:, None] - state.estimates, self.players
        log_scale = LOG_SCALE_UNIT * observations[self.layout.slices["log_scale"]].reshape(len(players), -1)
        ways = jnp.clip(errors[self.layout.ego_order[players].T, players] / 10.0**log_scale, -3, 3)
        distances = jnp.log10(jnp.maximum(jnp.sqrt((errors**2).sum(0)), 1e-12))
        others = (np.arange(self.layout.num_players)[:, None] + players) % self.layout.num_players
        seen = jnp.concatenate([ways, (distances[others] - log_scale) / 2])
        return seen.reshape(-1, self.members).astype(jnp.float32)

    def _act(self, state: State, actions: Any) -> State:
        """Return the state after actions (n, M) of the players that learn; teammates follow their law."""
        actions = actions.reshape(self.layout.action_size, len(self.players), -1)
        if self.team.is_teammate.any():
            of_all = jnp.zeros((len(actions), self.layout.num_players, actions.shape[2]), actions.dtype)
            actions = of_all.at[:, self.players].set(actions)
        return self.world.step(state, self.team.complete(state, self.world.inputs(state, actions)))

    def _step(self, runner: Runner, key: Any) -> tuple[Runner, Steps]:
        of_actions, of_restarts = jax.random.split(key)
        steps, means, memory = self._look(runner)
        log_std = runner.params["log_std"]
        actions = means + jnp.exp(log_std) * jax.random.normal(of_actions, means.shape, jnp.float32)
        after = self._act(runner.state, actions)
        steps = steps._replace(
            actions=actions,
            log_probabilities=_log_probability(actions, means, log_std),
            rewards=self.world.rewards(runner.state, after)[self.players].astype(jnp.float32).reshape(-1),
            overs=jnp.tile(self.world.is_over(after), len(self.players)),
        )
        state = self.world.restarted(of_restarts, after)
        return runner._replace(state=state, memory=memory, starts=steps.overs), steps

    def _advantages(self, steps: Steps, last_values: Any, scale: Any) -> Any:
        """Return generalised advantage estimates, (T, M); the end of an episode is a termination."""

        def back(carry: Any, step: Any) -> Any:
            advantage, after = carry
            reward, value, over = step
            discount = self.configuration.discount * (1 - over.astype(jnp.float32))
            advantage = reward / scale + discount * after - value + discount * GAE_LAMBDA * advantage
            return (advantage, value), advantage

        first = jnp.zeros_like(last_values), last_values
        return jax.lax.scan(back, first, (steps.rewards, steps.values, steps.overs), reverse=True)[1]

    def _loss(self, params: Any, steps: Steps, advantages: Any, returns: Any, memory: Any) -> Any:
        """Return PPO's loss of a minibatch, whose arrays are (T, …, C)."""
        means, remembered = _replay(params["actor"], steps.observations, memory, steps.starts[:, 0])
        parts = steps.observations, steps.state_seen, steps.actions, steps.log_probabilities, advantages, returns
        observations, seen, actions, before, gain, returns = map(_join_steps, parts)
        values, _ = run_layers(params["critic"], _critic_sees(observations, seen, remembered), None)
        change = _log_probability(actions, means, params["log_std"]) - before[0]
        ratio = jnp.exp(jnp.minimum(change, math.log(LARGEST_RATIO)))
        gain = (gain[0] - gain.mean()) / (gain.std() + 1e-8)
        surrogate = jnp.minimum(ratio * gain, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * gain)
        return VALUE_WEIGHT * ((values - returns) ** 2).mean() - surrogate.mean()

    def _evaluate(self, weights: Weights) -> Any:
        """Return the digits of the mean actions on the validation episodes."""

        def step(carry: Any, _: None) -> Any:
            state, memory = carry
            actions, memory = run_layers(weights, self._observe(state), memory)
            return (self._act(state, actions), memory), None

        units = self.configuration.hidden[-1]
        first = self.validation, jnp.zeros((units, len(self.players) * CURVE_EPISODES), jnp.float32)
        (state, _), _ = jax.lax.scan(step, first, length=self.world.numpy.clock.total_steps)
        return self.world.digits(state)


def _draw_weights(key: Any, shapes: dict[str, tuple[int, ...]], gain: float) -> Weights:
    """Draw orthogonal weights, those before a rectifier times √2, the last ones times a gain; biases are 0."""
    gains, weights = {"out": gain, "in": 1.0, "again": 1.0}, {}
    for (name, shape), each in zip(shapes.items(), jax.random.split(key, len(shapes)), strict=True):
        draw = jax.nn.initializers.orthogonal(gains.get(name, 2**0.5))
        stack = [draw(one, shape[-2:], jnp.float32) for one in jax.random.split(each, math.prod(shape[:-2]))]
        weights[name] = jnp.zeros(shape, jnp.float32) if name.endswith("bias") else jnp.stack(stack).reshape(shape)
    return weights


def _log_probability(actions: Any, means: Any, log_std: Any) -> Any:
    """Return the logarithm of the probability density of actions (n, M), less a constant."""
    return -(0.5 * ((actions - means) * jnp.exp(-log_std)) ** 2 + log_std).sum(0)


def _critic_sees(observations: Any, state_seen: Any, memory: Any) -> Any:
    """Return what a critic sees: it does not teach the actor what to remember."""
    return jnp.concatenate([observations, state_seen, jax.lax.stop_gradient(memory)])


def _join_steps(array: Any) -> Any:
    """Return (T, size, C) as (size, T·C)."""
    steps, size, columns = array.shape
    return jnp.moveaxis(array, 1, 0).reshape(size, steps * columns)


def _replay(weights: Weights, observations: Any, memory: Any, starts: Any) -> tuple[Any, Any]:
    """Return the outputs of a network for observations (T, size, C) from a memory (units, C), and what it remembers.

    The shapes are (outputs, T·C) and (units, T·C), with no units for a network without memory.
    """
    length, _, columns = observations.shape
    hidden = read_in(weights, _join_steps(observations))
    if not is_recurrent(weights):
        return read_out(weights, hidden), hidden[:0]

    def remember(memory: Any, step: Any) -> Any:
        inputs, start = step
        memory = update_hidden(inputs, weights["again"], jnp.where(start, 0, memory))
        return memory, memory

    inputs = jnp.moveaxis(hidden.reshape(*hidden.shape[:2], length, columns), 2, 0)
    remembered = _join_steps(jax.lax.scan(remember, memory, (inputs, starts))[1])
    return read_out(weights, remembered), remembered


def train(
    configuration: Configuration, out: Path, progress: Callable[[int, int, float], None] | None = None
) -> RunSummary:
    """Train, as :func:`ptne_env.training.sb3.train` does and with its arguments; 64-bit numbers of JAX are switched on.

    Raises:
        ValueError: for values that do not fit each other, for an unknown scenario, when ``out`` holds a run with
            another configuration or a damaged one, and when the trained policy fails on a validation episode.
    """
    checkpoint = out / "checkpoint.npz"
    if (ended := read_finished_run(configuration, out)) is not None:
        return ended
    jax.config.update("jax_enable_x64", True)  # noqa: FBT003 - of JAX
    began = monotonic()
    learner = Learner(configuration)
    leaves, structure = jax.tree.flatten(learner.start())
    curve, *leaves = read_checkpoint(checkpoint, [np.empty((0, CURVE_EPISODES)), *leaves])
    runner = jax.tree.unflatten(structure, map(jnp.asarray, leaves))
    write_record(out / "configuration.json", configuration)
    chunk = learner.updates_per_chunk * configuration.rollout * learner.members
    resumed_at = len(curve) * chunk
    while len(curve) < learner.chunks:
        runner = learner.train_chunk(runner)
        curve = np.append(curve, [learner.evaluate(runner.average)], axis=0)
        write_checkpoint(checkpoint, [curve, *jax.tree.leaves(runner)])
        write_learning_curve(out, np.arange(1, len(curve) + 1) * chunk, curve)
        if progress is not None:
            progress(len(curve) * chunk, learner.chunks * chunk, float(curve[-1].mean()))
    layout = learner.layout
    content = seal(runner.average, Metadata(layout.interface, layout.action_dims, layout.slots, asdict(configuration)))
    return finish(out, content, learner.track, len(curve) * chunk, resumed_at, began)
