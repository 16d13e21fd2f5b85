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

STEPS = 12
"""Greatest number of steps in one stage of the polish; most need four."""


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
    columns = np.empty((2, points.shape[0]), np.float32)
    for k in range(points.shape[0]):
        columns[0, k], columns[1, k] = points[k, 0], points[k, 1]
    samples = np.empty(points.shape[0], np.int32)
    scatter(population, bounds, state)
    for d in range(3):
        population[0, d] = prior[d]
    best = 0
    for i in range(size):
        x, y, a = population[i, 0], population[i, 1], population[i, 2]
        score = sampled_score(columns, origin, slots, tiles, x, y, a, samples)
        values[i] = weight * score + log_prior(prior, x, y, a)
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
            value = weight * sampled_score(columns, origin, slots, tiles, x, y, a, samples) + bound
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


_GRID = "Tuple((f8[::1], i4[:,:,::1], f8[:,::1]))"
"""Origin, slots and normals of a transform, as `ndt_kernels` lays them out."""


@njit(f"f8(f8[:,::1], {_GRID}, {_GRID}, f8[::1], f8[::1], f8[::1], f8[:,:,::1])", cache=True, nogil=True)
def blend(points, wide, fine, stage, pose, gradient, curvature):
    """Return the score at `pose` with its derivatives, as `derivatives` does, from wide cells and fine ones.

    `stage`: variance (m^2) added to the cells, and the share of the fine cells in the sum.
    """
    origin, slots, normals = wide
    blur, share = stage[0], stage[1]
    score = derivatives(points, origin, slots, normals, pose, blur, gradient, curvature[0], curvature[1])
    if share > 0.0:
        origin, slots, normals = fine
        slope, bends = np.empty(3), np.empty((2, 3, 3))
        finer = derivatives(points, origin, slots, normals, pose, blur, slope, bends[0], bends[1])
        score += share * (finer - score)
        for i in range(3):
            gradient[i] += share * (slope[i] - gradient[i])
            for j in range(3):
                for k in range(2):
                    curvature[k, i, j] += share * (bends[k, i, j] - curvature[k, i, j])
    return score


@njit("b1(f8[::1], f8[:,:,::1], f8[::1], f8[::1], f8, f8, f8[::1])", cache=True, nogil=True)
def newton_step(gradient, curvature, prior, pose, trust, damping, step):
    """Write the step of the log-posterior's damped Newton method; False where none rises."""
    weight = prior[13]
    slope = np.empty(3)
    system = np.empty((3, 3))
    for i in range(3):
        slope[i] = weight * gradient[i]
        for j in range(3):
            information = trust * prior[3 + 3 * i + j]
            slope[i] -= information * (pose[j] - prior[j])
            system[i, j] = information - weight * curvature[0, i, j]
        system[i, i] += damping * weight * curvature[1, i, i]
    if solve(system, slope, step):
        return True
    # Not concave here: the Gauss-Newton matrix is, and rises.
    for i in range(3):
        for j in range(3):
            system[i, j] = trust * prior[3 + 3 * i + j] + weight * curvature[1, i, j]
        system[i, i] += damping * weight * curvature[1, i, i]
    return solve(system, slope, step)


@njit(
    f"f8(f8[:,::1], {_GRID}, {_GRID}, f8[::1], f8[:,::1], f8[::1], f8[:,:,::1], f8[::1])",
    cache=True,
    nogil=True,
)
def polish(points, wide, fine, prior, stages, pose, curvature, report):
    """Polish `pose` by a damped Newton method on the exact score plus a normal prior; return the score.

    A step that does not rise is not taken, and the next one is shorter (Levenberg and Marquardt): where the
    cells of the reference contradict each other, free steps wander off by a decimetre.

    `points` (N, 4) as `ndt_kernels.derivatives` takes them.

    `stages` (S, 2): variance (m^2) added to the cells, share of the fine cells; coarse to fine. `curvature`
    (2, 3, 3): Hessian of the score, and its Gauss-Newton information, at the end. `report`: evaluations used,
    last step (m, rad).
    """
    weight = prior[13]
    # The weight that Student's t gives the prior where the search ended.
    trust = (prior[12] + 3.0) / (prior[12] + mahalanobis(prior, pose[0], pose[1], pose[2]))
    gradient, slope = np.empty(3), np.empty(3)
    bends = np.empty((2, 3, 3))
    step, trial = np.zeros(3), np.empty(3)
    score = size = turn = 0.0
    evaluations = 0
    for s in range(stages.shape[0]):
        stage = stages[s]
        score = blend(points, wide, fine, stage, pose, gradient, curvature)
        height = weight * score - 0.5 * trust * mahalanobis(prior, pose[0], pose[1], pose[2])
        evaluations += 1
        damping = 0.0
        for _ in range(STEPS):
            if not newton_step(gradient, curvature, prior, pose, trust, damping, step):
                break
            # No farther than a cell's reach in one step: beyond it the quadratic says nothing.
            size, turn = np.hypot(step[0], step[1]), abs(step[2])
            shrink = min(1.0, 0.1 / max(size, 1e-12), 0.05 / max(turn, 1e-12))
            for i in range(3):
                trial[i] = pose[i] + shrink * step[i]
            found = blend(points, wide, fine, stage, trial, slope, bends)
            reached = weight * found - 0.5 * trust * mahalanobis(prior, trial[0], trial[1], trial[2])
            evaluations += 1
            if reached >= height:
                damping *= 0.25
                height, score = reached, found
                for i in range(3):
                    pose[i] = trial[i]
                    gradient[i] = slope[i]
                    for j in range(3):
                        curvature[0, i, j] = bends[0, i, j]
                        curvature[1, i, j] = bends[1, i, j]
            else:
                damping = max(4.0 * damping, 0.5)
            if size < 1e-5 and turn < 1e-5:
                break
    report[0] = evaluations
    report[1] = size
    report[2] = turn
    return score
