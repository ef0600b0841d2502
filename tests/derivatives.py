"""Own gradients beside numerical derivatives of the costs."""

import numpy as np
import scipy


def gradient_error(game, radius=5.0):
    """The largest |own gradient − numerical derivative of J_i| / (1 + |derivative|) at points of the box.

    Components without bounds are at most the radius, and those with one bound next to it.
    """
    low, high = game.bounds
    lowest = np.where(np.isfinite(low), low, np.where(np.isfinite(high), high - 2 * radius, -radius))
    highest = np.where(np.isfinite(high), high, lowest + 2 * radius)
    points = np.random.default_rng(0).uniform(lowest, highest, (game.dimension, 64))
    # A cost need not be defined outside the box, so derivatives there are taken on the wider side.
    side = np.where(high - points >= points - low, 1, -1)
    components, samples = np.indices(points.shape)

    def costs(values, component, sample):
        component, sample = (np.broadcast_to(index, values.shape).ravel() for index in (component, sample))
        moved, columns = points[:, sample], np.arange(values.size)
        moved[component, columns] = values.ravel()
        return game.costs(moved)[game.owners[component], columns].reshape(values.shape)

    numerical = scipy.differentiate.derivative(
        costs,
        points,
        args=(components, samples),
        initial_step=np.minimum(0.5, (high - low) / 8),
        step_direction=np.where(np.isfinite(low) | np.isfinite(high), side, 0),
    ).df
    return float(np.max(np.abs(game.pseudo_gradient(points) - numerical) / (1 + np.abs(numerical))))
