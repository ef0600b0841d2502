"""Attacks on the suite: laws that gain digits from the channel and not from the game, and a table of what they gain.

``python tests/execution/attacks.py [EPISODES]`` prints, for every track but nominal, digits at T and their mean over
the second half of the steps: those of relay, and what the attacks gain over it.
"""

import sys
from dataclasses import replace
from functools import partial

import numpy as np

from ptne_env.evaluation.audit import Witness, rows_of_one, with_links_of
from ptne_env.evaluation.rollout import rollout
from ptne_env.laws import Coded, Law, Relay
from ptne_env.laws.base import per_step
from ptne_env.perception.encoder import Encoder
from ptne_env.suites import get_suite
from ptne_env.world import distances

FILL = 0.95  # of the range, so that nothing is clipped
OWN = 1e6  # times that the own equations count as heard


class Attack(Law):
    """A law around relay. Its memory: the number of steps, arrays of some shapes, that of relay."""

    def __init__(self, layout, *shapes):
        super().__init__(layout)
        self.inner, self.shapes = Relay(layout), ((1,), *shapes)
        reach = layout.action_bound * layout.largest_clock[2] / 2  # so that inputs can ask for every move
        self.most = FILL * min(layout.message_range, reach)

    def initial_memory(self, rows):
        return (*(np.zeros((rows, *shape)) for shape in self.shapes), self.inner.initial_memory(rows))

    def moved(self, observation, memory):
        """The displacement (R, n) that relay wants, and its memory."""
        inputs, after = self.inner.inputs(observation, memory)
        return inputs * observation.theta, after

    def answer(self, moved, observation, *parts):
        """Inputs and memory from displacements (R, n) and the parts of the memory."""
        return per_step(moved, observation), parts

    def is_last(self, observation):
        """Whether this is the last step, shape (R, 1)."""
        return self.layout.largest_clock[1] - observation.transformed <= 1.5 * observation.theta


class Loud(Attack):
    """relay in the coordinates z = x/A: it plays A z, so that noise shrinks by A, and z in the last step.

    In affine games the gradient at z is (∂J(A z) − ∂J(0))/A + ∂J(0), so the first step goes to 0. In the first ``wait``
    steps old messages arrive, and nothing moves.
    """

    def __init__(self, layout, gain=3.0, wait=1):
        super().__init__(layout, (layout.dimension,), (layout.dimension,))
        self.inner = Relay(replace(layout, input_limit=layout.input_limit / gain))
        self.gain, self.wait = gain, wait

    def inputs(self, observation, memory):
        step, start, offset, before = memory
        estimate, gain, waits = observation.own_estimate, self.gain, step <= self.wait
        start = np.where(step == 0, estimate, start)
        offset = np.where(step == 1, observation.gradient, offset)
        gradient, relative = (observation.gradient - offset) / gain + offset, observation.relative_estimates / gain
        seen = observation._replace(own_estimate=estimate / gain, relative_estimates=relative, gradient=gradient)
        moved, after = self.moved(seen, before)
        target = np.where(self.is_last(observation), 1.0, gain) * (seen.own_estimate + moved)
        target = np.where(step == 0, 0.0, np.where(waits, gain * start, target))
        after = self.select_rows(waits[:, 0], before, after)
        return self.answer(target - estimate, observation, step + 1, start, offset, after)


class Equations(Attack):
    """A coder of equations: players identify their own conditions F_c(x) = 0, tell them, and solve all of them.

    For n + 3 steps a player moves its estimates and fits its own gradient by an affine function. Then its estimate of
    component c carries entry k mod (n + 3) of equation c: n coefficients, the constant in units of 64 and two
    checksums; or 0 where it knows no equation. From step ``switch`` on it rests at the solution. A player follows
    relay if it has learned nothing in four rounds, or then lacks an equation. The largest entry is sent as
    ``size``, by default so that it fills the range.
    """

    def __init__(self, layout, switch=150, size=np.inf):
        n, self.entries = layout.dimension, layout.dimension + 3
        points, codes = (self.entries, n + max(layout.action_dims)), (layout.slots, n, self.entries)
        super().__init__(layout, points, codes, (n, n + 1), (n,))
        self.switch, self.size = switch, min(size, self.most)
        angles = np.arange(1.0, n + 2)
        self.checks = np.stack([np.cos(angles), np.sin(angles)], axis=1) / 2

    def inputs(self, observation, memory):
        step, points, codes, equations, heard, before = memory
        n, number, estimate = self.layout.dimension, int(step[0, 0]) - self.entries, observation.own_estimate
        own, follows, after = self.layout.own_mask[observation.player], np.zeros((len(step), 1), dtype=bool), before
        if number < 0:
            places = np.minimum(self.layout.own_components[observation.player], n - 1)
            gradients = np.take_along_axis(observation.gradient, places, axis=1)
            points = points.copy()
            points[:, number] = np.concatenate([estimate, gradients], axis=1)
            scale = np.maximum(np.abs(estimate).max(axis=1, keepdims=True), 1.0) / 2
            turns = (np.arange(n) == number + self.entries) | ((number >= -3) & (np.arange(n) % 2 == number % 2))
            moved = np.where(turns, np.where(estimate > 0, -scale, scale), 0.0)
        elif number + self.entries < self.switch:
            place = number % self.entries
            if number == 0:
                equations, heard = self._fitted(observation.player, points), OWN * own
            else:
                content = np.where(observation.weights[:, :, None] > 0, estimate[:, None], 0.0)
                codes = codes.copy()
                codes[..., place - 1] = (content + observation.relative_estimates) / self.size
                if place == 0:
                    equations, heard = self._learned(codes, equations, heard)
            coded = self._checked(equations)[:, :, place]
            moved = self.size * np.where(heard > 0, coded, 0.0) - estimate
            follows = (number >= 4 * self.entries) & ((heard == 0) | own).all(axis=1, keepdims=True)
        else:
            target = np.einsum("rab,rb->ra", np.linalg.pinv(equations[:, :, :n]), 64 * equations[:, :, n])
            moved, follows = target - estimate, (heard == 0).any(axis=1, keepdims=True)
        if follows.any():
            relayed, after = self.moved(observation, before)
            moved, after = np.where(follows, relayed, moved), self.select_rows(follows[:, 0], after, before)
        return self.answer(moved, observation, step + 1, points, codes, equations, heard, after)

    def _checked(self, equations):
        """Equations (R, n, n + 1) and their checksums, (R, n, n + 3)."""
        return np.concatenate([equations, equations @ self.checks], axis=2)

    def _learned(self, codes, equations, heard):
        """The means of all intact equations, and how often each was heard, after a round."""
        whole, largest = codes[..., :-2], np.abs(codes).max(axis=3)
        error = np.abs(whole @ self.checks - codes[..., -2:]).max(axis=3)
        intact = (error <= 2e-4 * (1 + largest)) & (largest > 0.3) & (heard < OWN)[:, None]
        count, total = intact.sum(axis=1), np.where(intact[..., None], whole, 0.0).sum(axis=1)
        mean = (heard[:, :, None] * equations + total) / np.maximum(heard + count, 1)[:, :, None]
        return mean, heard + count

    def _fitted(self, player, points):
        """The own equations, whose largest entry is 1, in the places of own components; 0 elsewhere."""
        n, own = self.layout.dimension, self.layout.own_components[player]
        known = np.concatenate([points[:, :, :n], np.full((*points.shape[:2], 1), -64.0)], axis=2)
        fit = np.einsum("rep,rpm->rme", np.linalg.pinv(known), points[:, :, n:])
        result = np.zeros((len(points), n + 1, n + 1))  # with a row for padding
        result[np.arange(len(points))[:, None], own] = fit / np.maximum(np.abs(fit).max(axis=2, keepdims=True), 1e-9)
        return result[:, :n]


def beginning(track, episodes, seed=0):
    """The initial state of the first test episodes of a track."""
    return replace(get_suite("ptne-v1").episode_set(track.name, seed=seed), count=episodes).initial_state(track.world)


def played(track, law, episodes, seed=0, *, audit=False):
    """Digits at T, and their mean over the second half of the steps, shape (2, B); an audit raises a PolicyError."""
    encoder, witnesses = Encoder(track.world, Relay.interface), []
    if audit:
        player, rows = rows_of_one(episodes, encoder.layout.num_players)
        witnesses = [Witness(law(with_links_of(encoder.layout, player)), rows)]
    team, start = track.teammates and track.teammates.join(track.world), beginning(track, episodes, seed)
    found = rollout(law(encoder.layout), encoder, start, team, witnesses=witnesses)
    digits, steps = distances.digits(found["estimate_distance"]), track.world.clock.steps
    return np.stack([digits[steps], digits[steps // 2 : steps + 1].mean(axis=0)])


def room(track, episodes, seed=0):
    """log10 of R over the largest start or equilibrium of the episodes."""
    start = beginning(track, episodes, seed)
    largest = max(np.abs(values).max() for values in (start.estimates, start.game.nash_equilibria))
    return np.log10(track.world.message_range / largest)


LOUD = {"rotation": partial(Loud, gain=5.0), "rates": partial(Loud, gain=5.0)}
"""Where not :class:`Loud` itself: the range is 5 times the strategies."""

CODER = partial(Equations, size=1.0)
"""The coder as it was: entries of order one."""


def main(episodes):
    """Print the table."""
    print("| track | room | relay | loud | coder | coder that fills the range | residuals |")
    print("| --- " + "| ---: " * 6 + "|")
    for track in get_suite("ptne-v1").tracks:
        if track.scenario.message_range:
            count, name = min(episodes, track.episodes or episodes), track.name
            base = played(track, Relay, count).mean(axis=1)
            cells = [f"{room(track, count):.2f}", "{:.2f} / {:.2f}".format(*base)]
            attacks = LOUD.get(name, Loud), CODER, Equations, partial(Coded, policy=Relay)
            gains = (played(track, attack, count).mean(axis=1) - base for attack in attacks)
            cells += ["{:+.2f} / {:+.2f}".format(*gain) for gain in gains]
            print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
