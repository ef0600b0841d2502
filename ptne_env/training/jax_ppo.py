"""PPO compiled with the world, by a network that all players share: ``ippo``, ``ippo-rnn`` and ``mappo-rnn``.

Independent learners (C. Schroeder de Witt et al., arXiv:2011.09533), feed-forward or with a gated recurrent unit, and
multi-agent PPO (C. Yu et al., arXiv:2103.01955), whose critic sees the state. Everything from rollout to update is one
``lax.scan``, as in PureJaxRL and JaxMARL. ``ptne train TRACK --out DIR`` runs it. ``DIR`` then holds ``policy.npz``,
``summary.json``, ``configuration.json``, the learning curve (``evaluations.npz``) and ``checkpoint.npz``, from which
the same command resumes an interrupted run: bit for bit, so that it ends as if nothing had happened.
"""

from __future__ import annotations

import io
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
from ptne_env.learn.layers import Weights, is_recurrent, read_in, read_out, run_layers, update_hidden, weight_shapes
from ptne_env.learn.npz_policy import open_policy, seal
from ptne_env.learn.onnx_policy import Metadata
from ptne_env.perception.fields import LOG_SCALE_UNIT
from ptne_env.shared.files import DamagedFileError, read_file, write_atomically
from ptne_env.suites import find_scenario
from ptne_env.training.configuration import Configuration, RunSummary, read_finished_run, write_record
from ptne_env.training.curve import validate, write_learning_curve
from ptne_env.world.dynamics import State

POLICY, CHECKPOINT = "policy.npz", "checkpoint.npz"
"""The names of the files of the policy and of the last checkpoint."""

CURVE = "digits"
"""The metric of the learning curve."""

RESUMES_EXACTLY = True
"""Whether a resumed run ends as if it had not been interrupted."""

EVALUATIONS, EPISODES = 20, 50
"""The number of evaluations, and of checkpoints, in a run; and the validation episodes of each."""

CLIP, GAE_LAMBDA, VALUE_WEIGHT, LARGEST_NORM = 0.2, 0.9, 0.5, 0.5
"""The settings of PPO that are as in Stable-Baselines3 and not tuned: ε, λ, the weight of the value's loss, and the
norm to which gradients are cut."""

AVERAGED_UPDATES, SCALE_DECAY = 50, 0.95
"""The updates over which weights are averaged; and the decay per update of the running unit of returns."""


class Runner(NamedTuple):
    """All that goes on from update to update.

    Attributes:
        params: the weights of ``actor`` and ``critic``, and ``log_std`` of the actions (n,).
        optimiser: the moments of Adam.
        average: the running mean of the actor's weights, which is evaluated and exported. Its digits do not depend on
            where the last updates happened to go.
        state: the environments.
        memory: those of actor and critic, (units, M).
        starts: whether a player's episode has just begun, (M,).
        scale: the standard deviation of returns, by which rewards are divided.
        done: the number of updates.
    """

    params: dict[str, Any]
    optimiser: Any
    average: Weights
    state: State
    memory: dict[str, Any]
    starts: Any
    scale: Any
    done: Any


class Steps(NamedTuple):
    """Steps of M players, environments last: (size, M) and (M,), or with an axis of T steps before them all."""

    observations: Any
    state_seen: Any
    actions: Any
    log_probabilities: Any
    values: Any
    rewards: Any
    overs: Any
    starts: Any


class Learner:
    """The compiled functions of a training."""

    def __init__(self, configuration: Configuration) -> None:
        self.configuration = configuration
        self.world = ptne_env.jax.JaxWorld(find_scenario(configuration.scenario), seed=configuration.seed)
        layout = self.layout = self.world.layout
        self.members = configuration.envs * layout.num_players
        self.is_recurrent = configuration.algorithm.endswith("-rnn")
        self.sees_state = configuration.algorithm.startswith("mappo")
        self.columns = self.members * (1 if self.is_recurrent else configuration.rollout)
        if self.columns % configuration.minibatches:
            what = "players of all environments" if self.is_recurrent else "samples of a rollout"
            raise ValueError(f"minibatches must divide the {self.columns} {what}, got {configuration.minibatches}")
        updates = -(-configuration.steps // (configuration.rollout * self.members))
        self.updates_per_chunk = -(-updates // EVALUATIONS)
        self.chunks = -(-updates // self.updates_per_chunk)
        total = self.chunks * self.updates_per_chunk * configuration.epochs * configuration.minibatches
        rate = optax.linear_schedule(configuration.learning_rate, 0.0, total)
        self.optimiser = optax.chain(optax.clip_by_global_norm(LARGEST_NORM), optax.adam(rate, eps=1e-5))
        validation = EpisodeSet(EPISODES, split="validation")
        self.validation = self.world.state(validation.initial_state(self.world.numpy))
        self.start, self.train_chunk = jax.jit(self._start), jax.jit(self._train_chunk)
        self.evaluate = jax.jit(self._evaluate)

    def _start(self) -> Runner:
        """Return the runner before the first update."""
        configuration, layout = self.configuration, self.layout
        of_actor, of_critic, of_episodes = jax.random.split(jax.random.key(configuration.seed), 3)
        size = layout.size + self.sees_state * (layout.dimension + layout.num_players)
        actor = self._draw_weights(of_actor, layout.size, layout.action_size, 0.01)
        params = {
            "actor": actor,
            "critic": self._draw_weights(of_critic, size, 1, 1.0),
            "log_std": jnp.full((layout.action_size, 1), configuration.log_std, jnp.float32),
        }
        units = configuration.hidden[-1] if self.is_recurrent else 0
        memory = {name: jnp.zeros((units, self.members), jnp.float32) for name in ("actor", "critic")}
        state = self.world.reset(of_episodes, configuration.envs)
        starts, one = jnp.ones(self.members, bool), jnp.ones((), jnp.float32)
        return Runner(params, self.optimiser.init(params), actor, state, memory, starts, one, jnp.zeros((), int))

    def _draw_weights(self, key: Any, size: int, outputs: int, gain: float) -> Weights:
        """Draw orthogonal weights, those before a rectifier times √2, the last ones times a gain; biases are 0."""
        shapes = weight_shapes(size, self.configuration.hidden, outputs, recurrent=self.is_recurrent)
        gains = {"out": gain, "in": 1.0, "again": 1.0}
        weights = {}
        for (name, shape), each in zip(shapes.items(), jax.random.split(key, len(shapes)), strict=True):
            draw = jax.nn.initializers.orthogonal(gains.get(name, 2**0.5), column_axis=-1)
            if name.endswith("_bias"):
                weights[name] = jnp.zeros(shape, jnp.float32)
            elif len(shape) == 3:
                weights[name] = jnp.stack([draw(key, shape[1:], jnp.float32) for key in jax.random.split(each, 3)])
            else:
                weights[name] = draw(each, shape, jnp.float32)
        return weights

    def _train_chunk(self, runner: Runner) -> Runner:
        runner, _ = jax.lax.scan(lambda runner, _: (self._update(runner), None), runner, length=self.updates_per_chunk)
        return runner

    def _update(self, runner: Runner) -> Runner:
        """Play a rollout, and learn from it."""
        configuration = self.configuration
        key = jax.random.fold_in(jax.random.key(configuration.seed), runner.done)
        of_steps, of_batches = jax.random.split(key)
        keys = jax.random.split(of_steps, configuration.rollout)
        after, steps = jax.lax.scan(self._step, runner, keys)
        (last, _), _ = self._look(after)
        advantages = self._advantages(steps, last.values, runner.scale)
        returns = advantages + steps.values
        # Sequences of players, or single samples where nothing is remembered, are shuffled into minibatches: (C, T, …).
        batch = [each.reshape(configuration.rollout, -1, self.members) for each in (*steps, advantages, returns)]
        length = configuration.rollout if self.is_recurrent else 1
        batch = [jnp.moveaxis(each, -1, 0).reshape(self.columns, length, each.shape[1]) for each in batch]
        memory = jax.tree.map(jnp.transpose, runner.memory)

        def learn(carry: Any, chosen: Any) -> tuple[Any, None]:
            params, optimiser = carry
            parts = [jnp.moveaxis(each[chosen], 0, -1) for each in batch]  # (T, …, C)
            start = {name: each[chosen].T if self.is_recurrent else each.T for name, each in memory.items()}
            slope = jax.grad(self._loss)(params, Steps(*parts[:-2]), *parts[-2:], start)
            change, optimiser = self.optimiser.update(slope, optimiser, params)
            return (optax.apply_updates(params, change), optimiser), None

        keys = jax.random.split(of_batches, configuration.epochs)
        orders = jnp.concatenate([jax.random.permutation(key, self.columns) for key in keys])
        orders = orders.reshape(configuration.epochs * configuration.minibatches, -1)
        (params, optimiser), _ = jax.lax.scan(learn, (runner.params, runner.optimiser), orders)
        share = 1 / jnp.minimum(runner.done + 1, AVERAGED_UPDATES).astype(jnp.float32)
        average = jax.tree.map(lambda old, new: old + share * (new - old), runner.average, params["actor"])
        unit = (returns * runner.scale).std()
        scale = jnp.where(runner.done == 0, unit, SCALE_DECAY * runner.scale + (1 - SCALE_DECAY) * unit)
        return after._replace(params=params, optimiser=optimiser, average=average, scale=scale, done=runner.done + 1)

    def _look(self, runner: Runner) -> tuple[tuple[Steps, Any], dict[str, Any]]:
        """Return what players see, with their values, the means of their actions, and what they remember."""
        observations = self.world.observe(runner.state).reshape(-1, self.members)
        seen = self._state_seen(runner.state, observations) if self.sees_state else observations[:0]
        memory = jax.tree.map(lambda each: jnp.where(runner.starts, 0, each), runner.memory)
        means, of_actor = run_layers(runner.params["actor"], observations, memory["actor"])
        values, of_critic = run_layers(runner.params["critic"], jnp.concatenate([observations, seen]), memory["critic"])
        nothing: Any = None
        steps = Steps(observations, seen, nothing, nothing, values[0], nothing, nothing, runner.starts)
        return (steps, means), {"actor": of_actor, "critic": of_critic}

    def _state_seen(self, state: State, observations: Any) -> Any:
        """Return what a critic of the state sees beside the observation, in ego order and of order one, (n + N, M).

        It is the way to the equilibrium in units of σ_i, and the logarithm of the distance of each player to it.
        """
        layout, players = self.layout, np.arange(self.layout.num_players)
        errors = state.game.nash_equilibria[:, None] - state.estimates
        log_scale = LOG_SCALE_UNIT * observations[layout.slices["log_scale"]].reshape(layout.num_players, -1)
        ways = jnp.clip(errors[layout.ego_order.T, players] / 10.0**log_scale, -3, 3)
        distances = jnp.log10(jnp.maximum(jnp.sqrt((errors**2).sum(0)), 1e-12))
        distances = (distances[(players[:, None] + players) % len(players)] - log_scale) / 2
        return jnp.concatenate([ways, distances]).reshape(-1, self.members).astype(jnp.float32)

    def _step(self, runner: Runner, key: Any) -> tuple[Runner, Steps]:
        of_actions, of_restarts = jax.random.split(key)
        (steps, means), memory = self._look(runner)
        log_std = runner.params["log_std"]
        actions = means + jnp.exp(log_std) * jax.random.normal(of_actions, means.shape, jnp.float32)
        world, state = self.world, runner.state
        wanted = actions.reshape(-1, self.layout.num_players, self.configuration.envs)
        after = world.step(state, world.inputs(state, wanted))
        steps = steps._replace(
            actions=actions,
            log_probabilities=_log_probability(actions, means, log_std),
            rewards=world.rewards(state, after).astype(jnp.float32).reshape(-1),
            overs=jnp.tile(world.is_over(after), self.layout.num_players),
        )
        return runner._replace(state=world.restarted(of_restarts, after), memory=memory, starts=steps.overs), steps

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
        starts = steps.starts[:, 0]
        means = _replay(params["actor"], steps.observations, memory["actor"], starts)
        seen = jnp.concatenate([steps.observations, steps.state_seen], axis=1)
        values = _replay(params["critic"], seen, memory["critic"], starts)
        actions, advantages, returns, old = (
            jnp.moveaxis(each, 1, 0).reshape(each.shape[1], -1)
            for each in (steps.actions, advantages, returns, steps.log_probabilities)
        )
        ratio = jnp.exp(_log_probability(actions, means, params["log_std"]) - old[0])
        gain = (advantages[0] - advantages.mean()) / (advantages.std() + 1e-8)
        surrogate = jnp.minimum(ratio * gain, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * gain)
        return VALUE_WEIGHT * ((values - returns) ** 2).mean() - surrogate.mean()

    def _evaluate(self, weights: Weights) -> Any:
        """Return the digits of the mean actions on the validation episodes."""
        players, units = self.layout.num_players, self.configuration.hidden[-1]

        def step(carry: Any, _: None) -> Any:
            state, memory = carry
            observations = self.world.observe(state).reshape(self.layout.size, -1)
            actions, memory = run_layers(weights, observations, memory)
            inputs = self.world.inputs(state, actions.reshape(-1, players, EPISODES))
            return (self.world.step(state, inputs), memory), None

        first = self.validation, jnp.zeros((units, players * EPISODES), jnp.float32)
        (state, _), _ = jax.lax.scan(step, first, length=self.world.numpy.clock.total_steps)
        return self.world.digits(state)


def _log_probability(actions: Any, means: Any, log_std: Any) -> Any:
    """Return the logarithm of the probability density of actions (n, M), less a constant."""
    return -(0.5 * ((actions - means) * jnp.exp(-log_std)) ** 2 + log_std).sum(0)


def _replay(weights: Weights, observations: Any, memory: Any, starts: Any) -> Any:
    """Return the outputs of a network for observations (T, size, C) from a memory (units, C), (outputs, T·C)."""
    length, _, columns = observations.shape
    hidden = read_in(weights, jnp.moveaxis(observations, 1, 0).reshape(-1, length * columns))
    if is_recurrent(weights):

        def remember(memory: Any, step: Any) -> Any:
            inputs, start = step
            memory = update_hidden(inputs, weights["again"], jnp.where(start, 0, memory))
            return memory, memory

        inputs = jnp.moveaxis(hidden.reshape(*hidden.shape[:2], length, columns), 2, 0)
        _, hidden = jax.lax.scan(remember, memory, (inputs, starts))
        hidden = jnp.moveaxis(hidden, 1, 0).reshape(-1, length * columns)
    return read_out(weights, hidden)


def train(
    configuration: Configuration, out: Path, progress: Callable[[int, int, float], None] | None = None
) -> RunSummary:
    """Train, validate and export, and return the summary; resume an interrupted run. A finished one is not repeated.

    64-bit numbers of JAX are switched on.

    Args:
        configuration: the definition of the run.
        out: the folder for all files of the run; made if missing.
        progress: a function to call after every evaluation with the agent-steps done, their total, and the digits.

    Raises:
        ValueError: for values that do not fit each other, for an unknown scenario, when ``out`` holds a run with
            another configuration or a damaged one, and when the trained policy fails on a validation episode.
    """
    if (ended := read_finished_run(configuration, out, POLICY)) is not None:
        return ended
    jax.config.update("jax_enable_x64", True)  # noqa: FBT003 - of JAX
    began = monotonic()
    learner = Learner(configuration)
    runner, curve = _restore(learner.start(), out / CHECKPOINT)
    write_record(out / "configuration.json", configuration)
    chunk = learner.updates_per_chunk * configuration.rollout * learner.members
    resumed_at = len(curve) * chunk
    while len(curve) < learner.chunks:
        runner = learner.train_chunk(runner)
        curve = np.append(curve, [learner.evaluate(runner.average)], axis=0)
        _save(runner, curve, out / CHECKPOINT)
        write_learning_curve(out, np.arange(1, len(curve) + 1) * chunk, curve)
        if progress is not None:
            progress(len(curve) * chunk, learner.chunks * chunk, float(curve[-1].mean()))
    layout = learner.layout
    metadata = Metadata(
        interface=layout.interface, action_dims=layout.action_dims, slots=layout.slots, training=asdict(configuration)
    )
    content = seal(jax.tree.map(np.asarray, runner.average), metadata)
    digits = validate(open_policy(Path(POLICY), content), learner.world.numpy.scenario)
    write_atomically(out / POLICY, content)
    summary = RunSummary(len(curve) * chunk, resumed_at, monotonic() - began, digits)
    write_record(out / "summary.json", summary)
    return summary


def _save(runner: Runner, curve: Any, path: Path) -> None:
    """Write a checkpoint: all arrays of the runner, and the digits of the evaluations so far."""
    buffer = io.BytesIO()
    np.savez(buffer, curve, *jax.tree.leaves(runner))
    write_atomically(path, buffer.getvalue())


def _restore(runner: Runner, path: Path) -> tuple[Runner, Any]:
    """Return the runner and curve of a checkpoint, or the given runner and an empty curve if there is none."""
    if not path.exists():
        return runner, np.empty((0, EPISODES))
    expected, structure = jax.tree.flatten(runner)
    try:
        with np.load(io.BytesIO(read_file(path, 1 << 30))) as file:
            curve, *leaves = (file[name] for name in file.files)
    except Exception as error:  # zip files raise many classes
        raise DamagedFileError(f"{path} is damaged, or no checkpoint: remove it to start again ({error})") from error
    if [(each.shape, each.dtype) for each in leaves] != [(each.shape, each.dtype) for each in expected]:
        raise DamagedFileError(f"{path} is the checkpoint of another run or version: remove it to start again")
    return jax.tree.unflatten(structure, [jnp.asarray(each) for each in leaves]), curve
