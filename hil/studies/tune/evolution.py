"""Covariance matrix adaptation (Hansen, The CMA Evolution Strategy: A Tutorial, arXiv:1604.00772): a search around a
start that is already good.

Differential evolution needs many generations to come to where it began. Here a batch of many candidates costs little
more than one of few, and generations are what a search pays for.
"""

from collections.abc import Callable

import numpy as np

from hil.control.laws.base import Array

SPREAD = 0.1  # of the first generation, in parts of a knob's range


def evolve(
    cost: Callable[[Array], Array], start: Array, population: int, generations: int, rng: np.random.Generator
) -> Array:
    """The best point (n,) met within the unit cube. cost: of points (population, n), each (population,). start: (n,),
    itself the first candidate. Generations beyond a first draw.
    """
    n = start.size
    parents = population // 2
    weights = np.log(parents + 0.5) - np.log(np.arange(1, parents + 1))
    weights /= weights.sum()
    mass = 1.0 / float((weights**2).sum())
    c_sigma = (mass + 2.0) / (n + mass + 5.0)
    d_sigma = 1.0 + 2.0 * max(0.0, np.sqrt((mass - 1.0) / (n + 1.0)) - 1.0) + c_sigma
    c_path = (4.0 + mass / n) / (n + 4.0 + 2.0 * mass / n)
    c_one = 2.0 / ((n + 1.3) ** 2 + mass)
    c_many = min(1.0 - c_one, 2.0 * (mass - 2.0 + 1.0 / mass) / ((n + 2.0) ** 2 + mass))
    usual = np.sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n))  # length of a normal vector
    mean, sigma, covariance, path, path_sigma = start.copy(), SPREAD, np.eye(n), np.zeros(n), np.zeros(n)
    best, least = start.copy(), np.inf
    for generation in range(generations + 1):
        values, axes = np.linalg.eigh(covariance)
        root = axes * np.sqrt(np.maximum(values, 1e-12))
        points = np.clip(mean + sigma * (rng.standard_normal((population, n)) @ root.T), 0.0, 1.0)
        if generation == 0:
            points[0] = start
        costs = cost(points)
        order = np.argsort(costs, kind="stable")
        if costs[order[0]] < least:
            best, least = points[order[0]].copy(), float(costs[order[0]])
        steps = (points[order[:parents]] - mean) / sigma
        step = weights @ steps
        mean = mean + sigma * step
        path_sigma = (1.0 - c_sigma) * path_sigma + np.sqrt(c_sigma * (2.0 - c_sigma) * mass) * (
            axes @ ((axes.T @ step) / np.sqrt(np.maximum(values, 1e-12)))
        )
        length = float(np.linalg.norm(path_sigma))
        still = length / np.sqrt(1.0 - (1.0 - c_sigma) ** (2 * (generation + 1))) < (1.4 + 2.0 / (n + 1.0)) * usual
        path = (1.0 - c_path) * path + still * np.sqrt(c_path * (2.0 - c_path) * mass) * step
        covariance = (
            (1.0 - c_one - c_many) * covariance
            + c_one * (np.outer(path, path) + (not still) * c_path * (2.0 - c_path) * covariance)
            + c_many * np.einsum("k,ki,kj->ij", weights, steps, steps)
        )
        sigma *= float(np.exp(c_sigma / d_sigma * (length / usual - 1.0)))
    return best
