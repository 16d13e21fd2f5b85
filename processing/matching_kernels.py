"""Compiled inner loops of matching: the search over the sampled score, and the polish on the exact one.

The objective is a log-posterior: weight * score(pose) + log prior(pose). The prior is Student's t while
searching, so that a motion the filter did not foresee is unlikely but not excluded, and the normal with the
same weight at the found pose while polishing.

`prior` (14,): pose (3), its information row by row (9), degrees of freedom, weight of the score.
"""

import numpy as np
from numba import njit

from processing.evolution_kernels import gathered, propose, scatter
from processing.ndt_kernels import derivatives, sampled_score


@njit("f8(f8[::1], f8, f8, f8)", cache=True, nogil=True)
def mahalanobis(prior, x, y, yaw):
    """Squared distance of a pose from the prior, in its information; yaws are a few radians apart at most."""
    dx, dy, da = x - prior[0], y - prior[1], yaw - prior[2]
    return (
        dx * (prior[3] * dx + 2.0 * prior[4] * dy + 2.0 * prior[5] * da)
        + dy * (prior[7] * dy + 2.0 * prior[8] * da)
        + prior[11] * da * da
    )


@njit("f8(f8[::1], f8, f8, f8)", cache=True, nogil=True)
def log_prior(prior, x, y, yaw):
    """Logarithm of Student's t in three dimensions, 0 at its centre."""
    return -0.5 * (prior[12] + 3.0) * np.log1p(mahalanobis(prior, x, y, yaw) / prior[12])


@njit(
    "i8(f8[:,::1], f8[::1], i4[:,:,::1], f4[:,::1], "
    "f8[::1], f8[:,::1], f8[::1], f8[:,::1], f8[::1], u8[::1])",
    cache=True,
    nogil=True,
)
def search(points, origin, slots, tiles, prior, bounds, rule, population, values, state):
    """Evolve `population` (NP, 3) in the box `bounds`; member 0 starts at the prior. Return the best member.

    `rule`: generations, F, CR, objective at which to stop, spread (3 numbers) at which to stop.
    `values` (NP + 2,): objective of each member; then the generations used and the evaluations used.
    """
    size = population.shape[0]
    weight = prior[13]
    scatter(population, bounds, state)
    for d in range(3):
        population[0, d] = prior[d]
    best = 0
    for i in range(size):
        x, y, a = population[i, 0], population[i, 1], population[i, 2]
        values[i] = weight * sampled_score(points, origin, slots, tiles, x, y, a) + log_prior(prior, x, y, a)
        if values[i] > values[best]:
            best = i
    trials = np.empty((size, 3))
    used = 0
    spread = rule[4:7]
    for generation in range(int(rule[0])):
        if values[best] >= rule[3] or gathered(population, spread):
            break
        for i in range(size):
            propose(population, i, bounds, rule[1], rule[2], trials[i], state)
        for i in range(size):
            x, y, a = trials[i, 0], trials[i, 1], trials[i, 2]
            bound = log_prior(prior, x, y, a)
            # The score cannot exceed one a point: a trial that the prior alone rules out is not evaluated.
            if bound + weight * points.shape[0] < values[i]:
                continue
            value = weight * sampled_score(points, origin, slots, tiles, x, y, a) + bound
            if value >= values[i]:
                values[i] = value
                population[i, 0], population[i, 1], population[i, 2] = x, y, a
                if value > values[best]:
                    best = i
        used = generation + 1
    values[size] = used
    values[size + 1] = size * (used + 1)
    return best


@njit("b1(f8[:,::1], f8[::1], f8[::1])", cache=True, nogil=True)
def solve(matrix, right, out):
    """Solve a symmetric positive definite 3 x 3 by Cholesky; False if it is not positive definite."""
    l00 = matrix[0, 0]
    if not l00 > 0.0:
        return False
    l00 = np.sqrt(l00)
    l10, l20 = matrix[1, 0] / l00, matrix[2, 0] / l00
    l11 = matrix[1, 1] - l10 * l10
    if not l11 > 1e-12 * matrix[1, 1]:
        return False
    l11 = np.sqrt(l11)
    l21 = (matrix[2, 1] - l20 * l10) / l11
    l22 = matrix[2, 2] - l20 * l20 - l21 * l21
    if not l22 > 1e-12 * matrix[2, 2]:
        return False
    l22 = np.sqrt(l22)
    y0 = right[0] / l00
    y1 = (right[1] - l10 * y0) / l11
    y2 = (right[2] - l20 * y0 - l21 * y1) / l22
    out[2] = y2 / l22
    out[1] = (y1 - l21 * out[2]) / l11
    out[0] = (y0 - l10 * out[1] - l20 * out[2]) / l00
    return True


@njit(
    "f8(f8[:,::1], f8[::1], i4[:,:,::1], f8[:,::1], f8[::1], f8[::1], f8[::1], f8[:,:,::1], f8[::1])",
    cache=True,
    nogil=True,
)
def polish(points, origin, slots, normals, prior, blurs, pose, curvature, report):
    """Polish `pose` by Newton's method on the exact score plus a normal prior; return the score.

    `blurs`: variances (m^2) added to the cells, one stage each, coarse to fine. `curvature` (2, 3, 3):
    Hessian of the score, and its Gauss-Newton information, at the end. `report`: iterations used, last step
    (m, rad).
    """
    weight = prior[13]
    # The weight that Student's t gives the prior where the search ended.
    trust = (prior[12] + 3.0) / (prior[12] + mahalanobis(prior, pose[0], pose[1], pose[2]))
    gradient = np.empty(3)
    system = np.empty((3, 3))
    step = np.zeros(3)
    score = 0.0
    iterations = 0
    for stage in range(blurs.shape[0]):
        for _ in range(12):
            score = derivatives(
                points, origin, slots, normals, pose, blurs[stage], gradient, curvature[0], curvature[1]
            )
            iterations += 1
            for i in range(3):
                slope = weight * gradient[i]
                for j in range(3):
                    information = trust * prior[3 + 3 * i + j]
                    slope -= information * (pose[j] - prior[j])
                    system[i, j] = information - weight * curvature[0, i, j]
                gradient[i] = slope
            if not solve(system, gradient, step):
                # Not concave here: the Gauss-Newton matrix is, and rises.
                for i in range(3):
                    for j in range(3):
                        system[i, j] = trust * prior[3 + 3 * i + j] + weight * curvature[1, i, j]
                if not solve(system, gradient, step):
                    break
            # No farther than a cell's reach in one step: beyond it the quadratic says nothing.
            size = np.hypot(step[0], step[1])
            shrink = min(1.0, 0.1 / max(size, 1e-12), 0.05 / max(abs(step[2]), 1e-12))
            for i in range(3):
                pose[i] += shrink * step[i]
            if size < 1e-5 and abs(step[2]) < 1e-5:
                break
    score = derivatives(
        points, origin, slots, normals, pose, blurs[blurs.shape[0] - 1], gradient, curvature[0], curvature[1]
    )
    report[0] = iterations
    report[1] = np.hypot(step[0], step[1])
    report[2] = abs(step[2])
    return score
