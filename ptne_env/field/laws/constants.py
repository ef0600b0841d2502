"""The constants of :class:`~ptne_env.field.laws.ObserverRelay`, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Constants:
    """Numbers without a unit unless they say so. A *share* is relative to the largest own estimate."""

    # When and how a player judges.
    start: int = 20
    """Steps after which noise, rounding and neighbours' planes are judged; before, estimates still move by more."""
    convincing: int = 20
    """Steps after which a neighbour that contradicts becomes the source."""
    fade: float = 0.7
    """The share of the recent error of predictions that is left after a step: one good prediction proves little."""
    smallest_curvature: float = 1e-3
    """Own curvatures below this count as this, where an error of the own gradient becomes a displacement."""

    # Noise and rounding.
    noisy: float = 3e-6
    """A smallest change of messages above this share may be noise; float32 rounds at a tenth of it."""
    calm: float = 10.0
    """It is noise where it has not halved for this many steps: estimates that settle halve their changes sooner."""
    still_noisy: float = 0.1
    """Noise stays noise down to this multiple of the smallest level: the smallest of many changes keeps falling."""
    moved: float = 1e-5
    """A change of a message below this share is no step of rounding."""
    coarse: float = 1e-4
    """A step of rounding below this share does not matter."""
    on_grid: float = 1e-2
    """Largest distance of a rounded message from a multiple of the step, in steps."""

    # Private means.
    forgetting_noisy: float = 2.0
    """p of the weights p/(p + k) of the k-th sample of a noisy message: early samples, of moving estimates, fade."""
    forgetting_rounded: float = 3.0
    """The same for rounded messages, which forget faster: their error is no noise that more samples would average."""
    forgetting_smooth: float = 2.0
    """The same for the mean of means, which makes the weights vanish at both ends."""
    reconnected: float = 6.0
    """Samples that the mean counts for at most when a link comes up again: the other side has moved."""
    recent: float = 0.03
    """Smallest weight of the present change in the variance of messages."""
    present: float = 0.1
    """The same in the present variance, which judges whether a mean lags."""
    present_limit: float = 1.5
    """The multiple of the present variance that limits the variance there: moves of estimates count as variance."""
    quick: float = 1 / 12
    """Weight of the present message in the quick mean, by which a mean that lags is noticed."""
    lag: float = 4.0
    """Standard deviations of the quick mean by which it may leave the mean."""
    smallest_variance: float = 1e-14
    """Variances count as this at least, so that means of equal messages can be weighed."""
    old: float = 40.0
    """Samples after which a mean is old enough to count beside those of sources."""
    beside: float = 0.5
    """The weight of such a mean: what does not come from a source is later."""
    settled: float = 20.0
    """A private belief farther from the own estimate than this many times σ_i has not settled."""

    # Liars.
    lying_samples: float = 20.0
    """Samples of statements about the own strategy before they are judged."""
    lying_deviations: float = 8.0
    """Standard deviations by which a lie is off."""
    lying_steps: float = 10.0
    """The number of such steps, less the others, that makes a liar."""
    lying_limit: float = 30.0
    """The largest number that counts: a player that stops lying is believed again."""

    # The weight of copies, and the end.
    patience: float = 2.0
    """Noisy copies have the weight max(patience/(patience + steps without rest beyond delay), floor)²."""
    delay: float = 30.0
    """See ``patience``: news travel first, averages later."""
    floor: float = 0.3
    """See ``patience``: slower copies would lag behind strategies that still move."""
    kept: float = 0.07
    """The weight that copies keep where links break, in addition: a search found it."""
    closing: float = 1.0
    """The last transformed time before the end of an episode, in which private means are stated."""
    closing_rounded: float = 0.5
    """The same where messages are rounded: their mean lives on the dither, which then stops."""

    # Damping of responses.
    window: int = 10
    """Steps in which the largest response must shrink."""
    shrinks: float = 0.8
    """The share of the window before that counts as shrinking."""
    damps: float = 0.8
    """The damping is multiplied by this where responses do not shrink, and divided by it where they settle."""
    recovered: float = 0.5
    """Below this share of the window before, responses settle."""
    least_damping: float = 0.3
    """Smallest damping: a player that hardly moves is of no use to others."""
    optimistic: float = 0.8
    """Below this damping, players respond to the gradient that they expect, ∂J_i + (∂J_i − ∂J_i before)."""
    audible_noise: float = 20.0
    """A response below this many times σ_i is no unrest."""
    audible: float = 1e-6
    """A response below this share is no unrest."""
    audible_errors: float = 100.0
    """A response below this many errors of predictions is no unrest."""

    # Pushes.
    push_seen: float = 1e-6
    """Smallest share by which a push displaces a strategy to be seen: above the resolution of observations."""
    push_steps: float = 25.0
    """Steps over which a constant push is averaged at most."""

    # Planes of the neighbours' reactions.
    warm_up: int = 3
    """Steps in which players move for identification, not in answer to messages."""
    plane_spread: float = 0.15
    """Standard deviation of the entries of R before anything is identified: players barely react to each other."""
    plane_common: float = 1000.0
    """Variance that all entries share, as a multiple of that of each: players tend to react alike to all."""
    rest_change: float = 1e-2
    """A message that changed less than this share of its change since the last sample is at rest."""
    rest: float = 1e-7
    """A message that changed less than this share is at rest."""
    new_sample: float = 1e-10
    """A displacement from the last sample below this share is no new sample."""
    resolution: float = 1e-7
    """Standard deviation of the entries of a sample, as a share."""
    soft: float = 0.3
    """The share of a plane's recent error that counts as deviation of its samples."""
    worst: float = 0.1
    """A plane with a recent error above this share does not count."""
    plane_samples: int = 3
    """Samples after which a plane counts."""
    curved: float = 1e-3
    """An own curvature below this is not known."""
    nearest: float = 1e-7
    """A joint solution nearer than this share brings nothing."""
    trusted: float = 3.0
    """A joint solution counts where it is this multiple of the largest recent error of its planes away, at least."""
    farthest: float = 0.5
    """A joint solution farther than this share is a mistake."""


C = Constants()
"""They are the same for every player and world."""
