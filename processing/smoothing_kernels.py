"""Compiled inner loops of the pose chain: linearise relations, multiply, solve a bare chain exactly.

Arrays and scalars in, results into given arrays; nothing is checked here (`smoothing` does that once a call).
Blocks are 3 x 3 (x, y, yaw); `diagonal[k]` belongs to pose k, `off[e]` couples the two poses of relation e.
"""

import numpy as np
from numba import njit


@njit("f8(f8[::1], f8[::1], f8[::1], f8[::1])", cache=True, nogil=True)
def relation_error(pose_i, pose_j, measured, error):
    """Write how far j seen from i is off the measured relation, in its frame; return the yaw of i."""
    c, s = np.cos(pose_i[2]), np.sin(pose_i[2])
    dx, dy = pose_j[0] - pose_i[0], pose_j[1] - pose_i[1]
    ex, ey = c * dx + s * dy - measured[0], -s * dx + c * dy - measured[1]
    cz, sz = np.cos(measured[2]), np.sin(measured[2])
    error[0], error[1] = cz * ex + sz * ey, -sz * ex + cz * ey
    error[2] = (pose_j[2] - pose_i[2] - measured[2] + np.pi) % (2.0 * np.pi) - np.pi
    return pose_i[2]


@njit("f8(f8[:,::1], i8[:,::1], f8[:,::1], f8[:,:,::1], f8[::1], f8[::1])", cache=True, nogil=True)
def chi_squares(poses, ends, measured, information, bends, chi2):
    """Write each relation's squared normalised error; return their sum after the robust loss.

    A relation with bend b > 0 costs b * chi2 / (b + chi2) (Geman and McClure), one with b = 0 costs chi2.
    """
    error = np.empty(3)
    total = 0.0
    for e in range(ends.shape[0]):
        relation_error(poses[ends[e, 0]], poses[ends[e, 1]], measured[e], error)
        value = 0.0
        for a in range(3):
            for b in range(3):
                value += error[a] * information[e, a, b] * error[b]
        chi2[e] = value
        total += value if bends[e] == 0.0 else bends[e] * value / (bends[e] + value)
    return total


@njit(
    "void(f8[:,::1], i8[:,::1], f8[:,::1], f8[:,:,::1], f8[::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1])",
    cache=True,
    nogil=True,
)
def linearise(poses, ends, measured, information, weights, diagonal, off, gradient):
    """Write the normal equations of all relations at `poses`: H (diagonal, off) and gradient (N, 3)."""
    diagonal[:] = 0.0
    gradient[:] = 0.0
    error = np.empty(3)
    A, B = np.zeros((3, 3)), np.zeros((3, 3))
    AW, BW = np.empty((3, 3)), np.empty((3, 3))
    for e in range(ends.shape[0]):
        i, j = ends[e, 0], ends[e, 1]
        yaw = relation_error(poses[i], poses[j], measured[e], error)
        dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
        c, s = np.cos(yaw + measured[e, 2]), np.sin(yaw + measured[e, 2])
        B[0, 0], B[0, 1], B[1, 0], B[1, 1], B[2, 2] = c, s, -s, c, 1.0
        A[0, 0], A[0, 1], A[1, 0], A[1, 1], A[2, 2] = -c, -s, s, -c, -1.0
        A[0, 2], A[1, 2] = -s * dx + c * dy, -c * dx - s * dy
        for a in range(3):
            for b in range(3):
                AW[a, b] = BW[a, b] = 0.0
                for m in range(3):
                    AW[a, b] += weights[e] * A[m, a] * information[e, m, b]
                    BW[a, b] += weights[e] * B[m, a] * information[e, m, b]
        for a in range(3):
            for b in range(3):
                off[e, a, b] = 0.0
                for m in range(3):
                    diagonal[i, a, b] += AW[a, m] * A[m, b]
                    diagonal[j, a, b] += BW[a, m] * B[m, b]
                    off[e, a, b] += AW[a, m] * B[m, b]
                gradient[i, a] += AW[a, b] * error[b]
                gradient[j, a] += BW[a, b] * error[b]


@njit("void(f8[:,::1], f8[:,::1])", cache=True, nogil=True)
def invert(m, out):
    """Write the inverse of a symmetric 3 x 3 by its cofactors; numba's own would need SciPy."""
    c0 = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    c1 = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c2 = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    scale = 1.0 / (m[0, 0] * c0 + m[0, 1] * c1 + m[0, 2] * c2)
    out[0, 0], out[0, 1], out[0, 2] = c0 * scale, c1 * scale, c2 * scale
    out[1, 1] = (m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2]) * scale
    out[1, 2] = (m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2]) * scale
    out[2, 2] = (m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]) * scale
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]


@njit("void(f8[:,::1], f8[::1], f8[::1])", cache=True, nogil=True, inline="always")
def add_product(block, x, y):
    """Do y += block x; three by three, written out because a BLAS call costs more than the work."""
    for a in range(3):
        y[a] += block[a, 0] * x[0] + block[a, 1] * x[1] + block[a, 2] * x[2]


@njit("void(f8[:,::1], f8[::1], f8[::1])", cache=True, nogil=True, inline="always")
def add_transposed_product(block, x, y):
    """Do y += block^T x."""
    for a in range(3):
        y[a] += block[0, a] * x[0] + block[1, a] * x[1] + block[2, a] * x[2]


@njit("void(f8[:,:,::1], i8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1])", cache=True, nogil=True)
def multiply(diagonal, ends, off, x, y):
    """Write y = H x; pose 0 is held."""
    y[:] = 0.0
    for k in range(x.shape[0]):
        add_product(diagonal[k], x[k], y[k])
    for e in range(ends.shape[0]):
        i, j = ends[e, 0], ends[e, 1]
        add_product(off[e], x[j], y[i])
        add_transposed_product(off[e], x[i], y[j])
    y[0] = 0.0


@njit("void(f8[:,:,::1], i8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1])", cache=True, nogil=True)
def factor_chain(diagonal, ends, off, inverse, lower):
    """Factor the block-tridiagonal part of H: `inverse` pivots and `lower` multipliers, pose 0 held."""
    count = diagonal.shape[0]
    coupling = np.zeros((count, 3, 3))
    for e in range(ends.shape[0]):
        i, j = ends[e, 0], ends[e, 1]
        # Written out: sums of slices take longer to compile than all the rest of this function.
        for a in range(3):
            for b in range(3):
                if j == i + 1:
                    coupling[j, a, b] += off[e, a, b]
                elif i == j + 1:
                    coupling[i, a, b] += off[e, b, a]
    inverse[0] = 0.0
    lower[:] = 0.0
    for k in range(1, count):
        pivot = diagonal[k].copy()
        if k > 1:
            for a in range(3):
                add_transposed_product(inverse[k - 1], coupling[k, :, a].copy(), lower[k, a])
            for a in range(3):
                for b in range(3):
                    for m in range(3):
                        pivot[a, b] -= lower[k, a, m] * coupling[k, m, b]
        invert(pivot, inverse[k])


@njit("void(f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1])", cache=True, nogil=True)
def solve_chain(inverse, lower, r, z):
    """Write z, the solution of the factored chain for r (N, 3)."""
    count = r.shape[0]
    hold = np.empty(3)
    z[0] = 0.0
    for k in range(1, count):
        for a in range(3):
            z[k, a] = r[k, a]
            if k > 1:
                for m in range(3):
                    z[k, a] -= lower[k, a, m] * z[k - 1, m]
    for k in range(count - 1, 0, -1):
        for a in range(3):
            hold[a] = z[k, a]
        z[k] = 0.0
        add_product(inverse[k], hold, z[k])
        if k < count - 1:
            for a in range(3):
                for m in range(3):
                    z[k, a] -= lower[k + 1, m, a] * z[k + 1, m]


@njit("f8(f8[:,::1], f8[:,::1])", cache=True, nogil=True)
def inner(x, y):
    """Return the sum of the products, in the order of the rows."""
    total = 0.0
    for k in range(x.shape[0]):
        for a in range(3):
            total += x[k, a] * y[k, a]
    return total


@njit("i8(f8[:,:,::1], i8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], i8, f8)", cache=True, nogil=True)
def conjugate_gradient(diagonal, ends, off, b, x, rounds, tolerance):
    """Solve H x = b by conjugate gradients with the chain as preconditioner; return the rounds it took."""
    count = b.shape[0]
    inverse, lower = np.empty((count, 3, 3)), np.empty((count, 3, 3))
    factor_chain(diagonal, ends, off, inverse, lower)
    x[:] = 0.0
    r = b.copy()
    r[0] = 0.0
    z, hp = np.empty_like(r), np.empty_like(r)
    solve_chain(inverse, lower, r, z)
    p = z.copy()
    rz = inner(r, z)
    enough = tolerance * tolerance * rz
    for done in range(rounds):
        if rz <= enough or rz <= 0.0:
            return done
        multiply(diagonal, ends, off, p, hp)
        alpha = rz / inner(p, hp)
        for k in range(count):
            for a in range(3):
                x[k, a] += alpha * p[k, a]
                r[k, a] -= alpha * hp[k, a]
        solve_chain(inverse, lower, r, z)
        fresh = inner(r, z)
        beta = fresh / rz
        for k in range(count):
            for a in range(3):
                p[k, a] = z[k, a] + beta * p[k, a]
        rz = fresh
    return rounds
