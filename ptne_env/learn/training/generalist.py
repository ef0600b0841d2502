"""One policy for every track: a gate network is trained by imitation, PPO and evolution, one stage after the other.

A run is a chain of segments: rounds of imitation, rollouts of PPO, generations of evolution. A segment depends on
nothing but network, optimiser, the scores of the stage's generations, and its number. A checkpoint follows each, so a
run that is resumed ends as an undisturbed one, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from time import monotonic
from typing import Annotated, Literal, NamedTuple

import numpy as np
import torch
from gymnasium import spaces
from pydantic import BeforeValidator, Field, NonNegativeInt, PositiveInt
from pydantic.dataclasses import dataclass
from stable_baselines3 import PPO

from ptne_env.evaluation.episodes import episode_seed
from ptne_env.evaluation.suite import find_scenario
from ptne_env.evaluation.workers import Workers
from ptne_env.field.laws.gated import GatedLaw
from ptne_env.learn.training import checkpoint, evolution
from ptne_env.learn.training.actor import GatePolicy
from ptne_env.learn.training.arguments import STRICT, WORD, as_tuple, readable
from ptne_env.learn.training.cells import CellVecEnv
from ptne_env.learn.training.checkpoint import CHECKPOINT, Record, Summary, finish, finished, plain, require_same
from ptne_env.learn.training.export import size_free_from_onnx, size_free_to_onnx
from ptne_env.learn.training.imitation import imitate
from ptne_env.learn.training.network import GateNetwork
from ptne_env.learn.training.worlds import training_world
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import World

Progress = Callable[[int, int, float, str], None]
"""Called with segments done, segments in all, recent mean digits, and the name of the stage.

Digits are NaN where the network played no episodes.
"""

Stage = Literal["imitation", "ppo", "evolution"]

_Rate = Annotated[float, Field(gt=0, le=1)]


@readable
@dataclass(frozen=True, config=STRICT)
class Generalist:
    """The definition of a run. Worlds are those of :mod:`ptne_env.learn.training.worlds`, or named scenarios.

    Attributes:
        stages: in their order. A stage that costs validation digits is undone.
        scenarios: names of scenarios or tracks to train on; random worlds if empty.
        start: file or name of the policy without sizes with which training starts; random weights if empty.
        worlds: number of random worlds.
        largest: cell-steps of an episode (players × components × steps), beyond which a random world is left out.
        cell_units, slot_units: of :class:`~ptne_env.learn.training.network.GateNetwork`.
        law: that is imitated, a name of :data:`~ptne_env.learn.training.network.POINTS`.
        rounds: of imitation.
        round_worlds: worlds in a round.
        round_rate: learning rate in the first round; it falls linearly.
        segments: of PPO.
        rollouts, rollout: rollouts in a segment, and steps in a rollout.
        places, place_worlds, place_episodes: of :class:`~ptne_env.learn.training.cells.CellVecEnv`, at most.
        team: as there.
        minibatch, epochs, rate, discount, trace, clip: of PPO; the learning rate falls linearly.
        log_std: initial logarithm of the standard deviation of gates.
        generations: of evolution.
        population: networks in a generation.
        worlds_each, episodes_each: worlds and episodes of each that a generation plays.
        sigma: initial standard deviation of evolution.
        layers: whether evolution changes all weights, and not those of the linear maps alone.
        validation_worlds, validation_episodes: on which stages are compared; the episodes are of each world.
        jobs: processes that play side by side; results do not depend on it.
        seed: of everything, below 2^32.

    Raises:
        ValueError: when an argument has another type or is out of its range, naming it and its value.
    """

    stages: Annotated[tuple[Stage, ...], Field(min_length=1), BeforeValidator(as_tuple)]
    scenarios: Annotated[tuple[str, ...], BeforeValidator(as_tuple)] = ()
    start: str = ""
    worlds: PositiveInt = 96
    largest: PositiveInt = 16_000
    cell_units: PositiveInt = 32
    slot_units: PositiveInt = 16
    law: str = "observer-relay"
    rounds: PositiveInt = 8
    round_worlds: PositiveInt = 24
    round_rate: _Rate = 3e-3
    segments: PositiveInt = 10
    rollouts: PositiveInt = 6
    rollout: PositiveInt = 32
    places: PositiveInt = 20
    place_worlds: PositiveInt = 6
    place_episodes: PositiveInt = 2
    team: Annotated[float, Field(ge=0, le=1)] = 0.5
    minibatch: PositiveInt = 8192
    epochs: PositiveInt = 2
    rate: _Rate = 3e-4
    discount: _Rate = 0.97
    trace: _Rate = 0.95
    clip: _Rate = 0.2
    log_std: Annotated[float, Field(ge=-20, le=5)] = -2.5
    generations: PositiveInt = 60
    population: Annotated[int, Field(ge=4)] = 24
    worlds_each: PositiveInt = 14
    episodes_each: PositiveInt = 1
    sigma: _Rate = 0.02
    layers: bool = False
    validation_worlds: PositiveInt = 30
    validation_episodes: PositiveInt = 4
    jobs: PositiveInt = 2
    seed: Annotated[int, Field(ge=0, lt=WORD)] = 0


@readable
@dataclass(frozen=True, config=STRICT)
class Course(Record):
    """The record of a run that goes on.

    Attributes:
        stage: index of the stage that goes on.
        segment: that is next in it.
        scores: of evolution so far, by generation and network.
        digits: of validation at the start and after each finished stage, of the network that was kept.
    """

    stage: NonNegativeInt
    segment: NonNegativeInt
    scores: Annotated[tuple[tuple[float, ...], ...], BeforeValidator(lambda rows: tuple(map(tuple, rows)))]
    digits: Annotated[tuple[float, ...], BeforeValidator(as_tuple)]


def train(arguments: Generalist, out: Path, progress: Progress | None = None) -> Summary:
    """Train, validate and export; resume where an interrupted run with the same arguments stopped.

    Args:
        arguments: of the run.
        out: folder for all files of the run; made if missing.
        progress: called after every segment.

    Returns:
        The summary, also in ``out/summary.json``.

    Raises:
        ValueError: for an unknown scenario, law or policy, and when ``out`` holds a run with other arguments, or a
            damaged one; no file is written then.
        FileNotFoundError: when there is no policy to start with.
    """
    began, path = monotonic(), out / CHECKPOINT
    done = finished(arguments, out)
    if done is not None:
        path.unlink(missing_ok=True)  # of an interruption after the end
        return done
    torch.set_num_threads(1)
    run = Run(arguments)
    course = Course(plain(arguments), 0, 0.0, 1, 0, 0, (), ())
    if path.exists():
        course, arrays = checkpoint.read(path, Course)
        require_same(arguments, course.arguments, out)
        checkpoint.restore(run, arrays)
        course = replace(course, parts=course.parts + 1)
    before = course.seconds

    def save() -> None:
        nonlocal course
        course = replace(course, seconds=before + monotonic() - began)
        checkpoint.save(path, run, course)

    if not course.digits:
        course = replace(course, digits=(run.keep(()),))
        save()
    lengths = [run.length(stage) for stage in arguments.stages]
    while course.stage < len(arguments.stages):
        name = arguments.stages[course.stage]
        outcome = run.segment(name, course.segment, course.scores)
        scores = (*course.scores, outcome.scores) if outcome.scores else ()
        steps = course.agent_steps + outcome.steps
        course = replace(course, segment=course.segment + 1, scores=scores, agent_steps=steps)
        if progress is not None:
            progress(sum(lengths[: course.stage]) + course.segment, sum(lengths), outcome.digits, name)
        if course.segment == lengths[course.stage]:
            run.end(name, course.scores)
            found = (*course.digits, run.keep(course.digits[course.stage :]))
            course = replace(course, stage=course.stage + 1, segment=0, scores=(), digits=found)
        save()
    digits = course.digits[-1]
    network = run.policy.actor
    names = arguments.scenarios or ("training-worlds",)
    content = size_free_to_onnx(
        network,
        interface=GatedLaw.interface,
        scenarios=names,
        steps=course.agent_steps,
        seed=arguments.seed,
        digits=digits,
    )
    return finish(out, content, course, digits, course.digits)


class Outcome(NamedTuple):
    """Of a segment: mean digits, agent-steps, and the scores of a generation."""

    digits: float
    steps: int
    scores: tuple[float, ...] = ()


class Run:
    """Network and optimiser of a run, and the stages that change them.

    Attributes:
        policy: holds both.
    """

    def __init__(self, arguments: Generalist) -> None:
        self.arguments = arguments
        self._worlds = self._drawn("train", arguments.worlds)
        self._validation = self._drawn("validation", arguments.validation_worlds)
        torch.manual_seed(arguments.seed)
        units = {"cell_units": arguments.cell_units, "slot_units": arguments.slot_units}
        start = size_free_from_onnx(arguments.start) if arguments.start else GateNetwork(**units)
        units = {"cell_units": len(start.first.bias), "slot_units": len(start.encoder.bias)}
        box = spaces.Box(-1.0, 1.0, (1,))
        self.policy = GatePolicy(box, box, lambda _: arguments.rate, log_std_init=arguments.log_std, network=units)
        self.policy.actor.load_state_dict(start.state_dict())
        self._law = GateNetwork.of_law(arguments.law)
        self._workers = Workers(arguments.jobs)

    def _drawn(self, split: Literal["train", "validation"], count: int) -> list[Scenario]:
        """The named scenarios, or the first random worlds that are small enough."""
        if self.arguments.scenarios:
            return [find_scenario(name) for name in self.arguments.scenarios]
        drawn: list[Scenario] = []
        index = 0
        while len(drawn) < count:
            scenario = training_world(0, index, split)
            index += 1
            if _cells(scenario) * World(scenario).clock.total_steps <= self.arguments.largest:
                drawn.append(scenario)
        return drawn

    def length(self, stage: Stage) -> int:
        """Segments of a stage."""
        arguments = self.arguments
        return {"imitation": arguments.rounds, "ppo": arguments.segments, "evolution": arguments.generations}[stage]

    def segment(self, stage: Stage, number: int, scores: tuple[tuple[float, ...], ...]) -> Outcome:
        """One segment of a stage."""
        generator = np.random.default_rng([self.arguments.seed, self.arguments.stages.index(stage), number])
        torch.manual_seed(int(generator.integers(2**32)))
        if stage == "imitation":
            return self._round(number, generator)
        if stage == "ppo":
            return self._rollouts(number, int(generator.integers(2**32)))
        return self._generation(generator, scores)

    def _round(self, number: int, generator: np.random.Generator) -> Outcome:
        arguments = self.arguments
        for group in self.policy.optimizer.param_groups:
            group["lr"] = arguments.round_rate * (1 - number / arguments.rounds)
        count = min(arguments.round_worlds, len(self._worlds))
        chosen = [self._worlds[index] for index in generator.choice(len(self._worlds), count, replace=False)]
        share = 1 - number / max(arguments.rounds - 1, 1)
        tasks = [(scenario, self._law) for scenario in chosen]
        digits = imitate(self.policy.actor, self.policy.optimizer, tasks, share, generator, self._workers)
        return Outcome(digits, 0)

    @cached_property
    def _env(self) -> CellVecEnv:
        """The environment of PPO: places with worlds of one number of cells, those with most worlds first."""
        arguments, by_size = self.arguments, dict[int, list[Scenario]]()
        for scenario in self._worlds:
            by_size.setdefault(_cells(scenario), []).append(scenario)
        most, places = arguments.place_worlds, list[list[Scenario]]()
        for worlds in sorted(by_size.values(), key=len, reverse=True):
            places.extend(worlds[first : first + most] for first in range(0, len(worlds), most))
        return CellVecEnv(places[: arguments.places], arguments.place_episodes, arguments.team)

    def _rollouts(self, number: int, seed: int) -> Outcome:
        arguments, env = self.arguments, self._env
        model = PPO(
            GatePolicy,
            env,
            n_steps=arguments.rollout,
            batch_size=min(arguments.minibatch, arguments.rollout * env.num_envs),
            n_epochs=arguments.epochs,
            learning_rate=arguments.rate * (1 - number / arguments.segments),
            gamma=arguments.discount,
            gae_lambda=arguments.trace,
            clip_range=arguments.clip,
            seed=seed,
            device="cpu",
        )
        model.policy = self.policy
        steps = arguments.rollout * arguments.rollouts * env.num_envs
        model.learn(steps)
        episodes = [episode["r"] for episode in model.ep_info_buffer or []]
        return Outcome(float(np.mean(episodes)) if episodes else float("nan"), steps)

    @property
    def _names(self) -> tuple[str, ...]:
        names = tuple(name for name, _ in self.policy.actor.named_parameters())
        return names if self.arguments.layers else evolution.LINEAR

    def _search(self, scores: tuple[tuple[float, ...], ...]) -> evolution.Search:
        start = evolution.vector(self.policy.actor, self._names)
        arguments = self.arguments
        return evolution.Search(start, arguments.sigma, arguments.population, arguments.seed, scores)

    def _generation(self, generator: np.random.Generator, scores: tuple[tuple[float, ...], ...]) -> Outcome:
        arguments = self.arguments
        count = min(arguments.worlds_each, len(self._worlds))
        chosen = generator.choice(len(self._worlds), count, replace=False)
        seeds = generator.integers(2**62, size=arguments.episodes_each).tolist()
        found = self._scores(self._search(scores).ask(), [self._worlds[index] for index in chosen], seeds)
        return Outcome(float(found.mean()), 0, tuple(evolution.utility(found).tolist()))

    def end(self, stage: Stage, scores: tuple[tuple[float, ...], ...]) -> None:
        """Finish a stage: evolution changes the network only now."""
        if stage == "evolution":
            evolution.write(self.policy.actor, self._names, self._search(scores).favourite)

    def keep(self, best: tuple[float, ...]) -> float:
        """Keep the actor if it has at least these digits on validation, or return to the network that was kept.

        Returns:
            The digits of the network that is kept.
        """
        digits, policy = self.validate(), self.policy
        if best and digits < best[0]:
            policy.actor.load_state_dict(policy.kept.state_dict())
            return best[0]
        policy.kept.load_state_dict(policy.actor.state_dict())
        return digits

    def validate(self) -> float:
        """Mean digits on episodes of validation."""
        seeds = [episode_seed(0, episode, "validation") for episode in range(self.arguments.validation_episodes)]
        vector = evolution.vector(self.policy.actor, evolution.LINEAR)
        return float(self._scores(vector[None], self._validation, seeds).mean())

    def _scores(self, vectors: np.ndarray, worlds: list[Scenario], seeds: list[int]) -> np.ndarray:
        """Digits by world and network."""
        names = self._names if len(vectors) > 1 else evolution.LINEAR
        tasks = [(self.policy.actor, names, vectors, scenario, seeds) for scenario in worlds]
        result = np.empty((len(worlds), len(vectors)))
        for index, found in self._workers.run(evolution.scores, tasks):
            result[index] = found
        return result


def _cells(scenario: Scenario) -> int:
    game = World(scenario).game
    return game.num_players * game.dimension
