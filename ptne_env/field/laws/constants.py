"""The constants of :class:`~ptne_env.field.laws.ObserverRelay`, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Constants:
    """Numbers without a unit unless they say so. A *share* is relative to the largest own estimate."""

    # When and how a player judges.
    start: int = 20  # steps before noise, rounding and planes are judged: until then, estimates move by more
    convincing: int = 20  # steps after which a neighbour that contradicts becomes the source
    fade: float = 0.7  # share of the recent error of predictions that is left after a step: one good one proves little
    smallest_curvature: float = 1e-3  # of an own component, where errors of the gradient become displacements

    # The weight of copies.
    copy_patience: float = 30.0  # steps without rest after which messages count as noisy, while that is not yet judged
    copy_forgetting: float = 2.0  # p of the weights p/(p + k) of copies then
    patience: float = 2.0  # noisy copies weigh max(patience/(patience + steps without rest beyond delay), floor)²
    delay: float = 30.0  # see patience: news travel first, averages later
    floor: float = 0.3  # see patience: slower copies would lag behind strategies that still move
    kept: float = 0.07  # weight that copies keep where links break, in addition: a search found it

    # Noise and rounding.
    noisy: float = 3e-6  # a smallest change of messages above this share may be noise; float32 rounds far below
    calm: float = 10.0  # it is noise where it has not halved for so many steps: what settles halves sooner
    still_noisy: float = 0.1  # noise down to this multiple is still noise: the smallest of many changes keeps falling
    moved: float = 1e-5  # a change of a message below this share is no step of rounding
    coarse: float = 1e-4  # a step of rounding below this share does not matter
    on_grid: float = 1e-2  # largest distance of a rounded message from a multiple of the step, in steps

    # Private means.
    forgetting_noisy: float = 2.0  # p of the weights p/(p + k) of noisy messages: early ones, of moving players, fade
    forgetting_rounded: float = 3.0  # the same for rounded messages, of which the first ones err alike and fade sooner
    forgetting_smooth: float = 2.0  # the same for the mean of means
    reconnected: float = 6.0  # samples that a mean counts for at most when a link comes up again: the sender has moved
    recent: float = 0.03  # smallest weight of the present change in the variance of messages
    present: float = 0.1  # the same in the present variance, which judges whether a mean lags
    present_limit: float = 1.5  # multiple of it that limits the variance there: moves of estimates count as variance
    quick: float = 1 / 12  # weight of the present message in the quick mean, by which a mean that lags is noticed
    lag: float = 4.0  # standard deviations of the quick mean by which it may leave the mean
    smallest_variance: float = 1e-14  # so that means of equal messages can be weighed
    old: float = 40.0  # samples after which a mean counts beside those of sources
    beside: float = 0.5  # weight of such a mean: what does not come from a source is later
    settled: float = 20.0  # a private belief farther from the own estimate than so many σ_i has not settled
    closing: float = 1.0  # last transformed time before the end, in which private means are stated
    closing_rounded: float = 0.5  # the same where messages are rounded: the means live on the dither, which then stops

    # Liars.
    lying_samples: float = 20.0  # statements about the own strategy before they are judged
    lying_deviations: float = 8.0  # standard deviations by which a lie is off
    lying_steps: float = 10.0  # number of lies, less the other statements, that makes a liar
    lying_limit: float = 30.0  # largest number that counts: who stops lying is believed again

    # Damping of responses.
    window: int = 10  # steps in which the largest response must shrink
    shrinks: float = 0.8  # share of the window before that counts as shrinking
    damps: float = 0.8  # factor of the damping where responses do not shrink; its inverse where they settle
    recovered: float = 0.5  # share of the window before below which they settle
    least_damping: float = 0.3  # a player that hardly moves is of no use to others
    optimistic: float = 0.8  # below this damping, players respond to the gradient that they expect in the next step
    audible_noise: float = 20.0  # a response below this many times σ_i is no unrest
    audible: float = 1e-6  # nor is one below this share
    audible_errors: float = 100.0  # nor one below this many errors of predictions

    # Pushes.
    push_seen: float = 1e-6  # smallest share by which a push is seen: above the resolution of observations
    push_steps: float = 25.0  # steps over which a constant push is averaged at most

    # Planes of the neighbours' reactions.
    warm_up: int = 3  # steps in which players move for identification, not in answer to messages
    plane_spread: float = 0.15  # deviation of the entries of R before any sample: players barely react to each other
    plane_common: float = 1000.0  # variance that all entries share, in that of each: players react alike to all others
    rest_change: float = 1e-2  # a message is at rest that changed less than this share of its way since the last sample
    rest: float = 1e-7  # or less than this share of the largest own estimate
    new_sample: float = 1e-10  # a displacement from the last sample below this share is no new sample
    resolution: float = 1e-7  # deviation of the entries of a sample, as a share: that of float32
    soft: float = 0.3  # share of a plane's recent error that counts as deviation of its samples
    worst: float = 0.1  # a plane with a recent error above this share does not count
    plane_samples: int = 3  # samples after which a plane counts
    curved: float = 1e-3  # an own curvature below this is not known
    nearest: float = 1e-7  # a joint solution nearer than this share brings nothing
    trusted: float = 3.0  # one is followed that is at least this many recent errors of its planes away
    farthest: float = 0.5  # one farther than this share is a mistake


C = Constants()
"""They are the same for every player and world."""
