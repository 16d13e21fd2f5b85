"""Compiled inner loops of saliency-based resampling, and of turning a sweep into points.

Arrays and scalars in and out; nothing is validated here; twins in tests/unit/naive_odometry.py.
"""

import numpy as np
from numba import njit


@njit("i8(f4[::1], f8[:,::1], f8[::1], f8[::1], f8[:,::1], i8[::1])", cache=True, nogil=True)
def end_points(ranges_m, directions, sweep, twist, points, beams):
    """Write the end points of the valid rays into `points`, as seen from one instant; return their number.

    `directions` (N, 2) are the cosine and sine of each bearing. `sweep`: least and greatest range (m), time
    between rays, time of the instant after the first ray (s). The laser is taken to keep the velocity
    `twist` (m/s, m/s, rad/s, its own frame), so that ray i leaves from the pose exp(twist (i dt -
    instant)).
    """
    count = 0
    range_min_m, range_max_m, time_increment_s, instant_s = sweep[0], sweep[1], sweep[2], sweep[3]
    still = time_increment_s == 0.0 or (twist[0] == 0.0 and twist[1] == 0.0 and twist[2] == 0.0)
    for i in range(ranges_m.shape[0]):
        r = ranges_m[i]
        # Written so that NaN fails: no information is not a point.
        if not (r >= range_min_m and r <= range_max_m and r > 0.0):
            continue
        x, y = r * directions[i, 0], r * directions[i, 1]
        if not still:
            t = i * time_increment_s - instant_s
            a = twist[2] * t
            c, s = np.cos(a), np.sin(a)
            # Translation of the constant twist: [sin a / a, -(1 - cos a) / a] turned; series near zero.
            if abs(a) < 1e-6:
                k, j = t, 0.5 * a * t
            else:
                k, j = s / twist[2], (1.0 - c) / twist[2]
            x, y = (c * x - s * y + k * twist[0] - j * twist[1], s * x + c * y + j * twist[0] + k * twist[1])
        points[count, 0] = x
        points[count, 1] = y
        beams[count] = i
        count += 1
    return count


@njit("void(f8[:,::1], i8[::1], i8, f8, f8[::1], f8[:,::1])", cache=True, nogil=True)
def cut(points, beams, count, increment_rad, rule, work):
    """Number the pieces, neighbours in bearing whose distance a surface of the steepest kept slant explains.

    `rule` and `work` are those of `resample`; so they are in the other steps.
    """
    pieces = 0
    work[0, 3] = 0.0
    for k in range(1, count):
        gap = beams[k] - beams[k - 1]
        dx, dy = points[k, 0] - points[k - 1, 0], points[k, 1] - points[k - 1, 1]
        near = min(np.hypot(points[k, 0], points[k, 1]), np.hypot(points[k - 1, 0], points[k - 1, 1]))
        if gap > 4 or np.hypot(dx, dy) > rule[0] * near * increment_rad * gap + 3.0 * rule[1]:
            pieces += 1
        work[k, 3] = pieces


@njit("void(f8[:,::1], i8, f8[:,::1])", cache=True, nogil=True)
def smooth(points, count, work):
    """Smooth each point along its piece, by two neighbours each side.

    Arc length over raw points counts the noise as way, and prefers the points that the noise pushed outward.
    """
    for k in range(count):
        reach = 0
        while (
            reach < 2
            and k - reach - 1 >= 0
            and k + reach + 1 < count
            and (work[k - reach - 1, 3] == work[k, 3] and work[k + reach + 1, 3] == work[k, 3])
        ):
            reach += 1
        sx = sy = 0.0
        for j in range(k - reach, k + reach + 1):
            sx += points[j, 0]
            sy += points[j, 1]
        work[k, 0] = sx / (2 * reach + 1)
        work[k, 1] = sy / (2 * reach + 1)


@njit("f8(i8, f8[::1], f8[:,::1])", cache=True, nogil=True)
def weigh(count, rule, work):
    """Sum the saliency up to each point of its piece; return that of all pieces."""
    begin = 0
    total = 0.0
    while begin < count:
        end = begin
        length = 0.0
        work[begin, 2] = 0.0
        while end + 1 < count and work[end + 1, 3] == work[begin, 3]:
            length += np.hypot(work[end + 1, 0] - work[end, 0], work[end + 1, 1] - work[end, 1])
            end += 1
        short = rule[4] * rule[5] / (rule[5] + length)
        lo = hi = begin
        for k in range(begin, end):
            # Direction of the contour over the support before and behind the step k -> k + 1.
            while lo < k and np.hypot(work[k, 0] - work[lo + 1, 0], work[k, 1] - work[lo + 1, 1]) >= rule[2]:
                lo += 1
            hi = max(hi, k + 1)
            while hi < end and np.hypot(work[hi, 0] - work[k + 1, 0], work[hi, 1] - work[k + 1, 1]) < rule[2]:
                hi += 1
            ax, ay = work[k, 0] - work[lo, 0], work[k, 1] - work[lo, 1]
            bx, by = work[hi, 0] - work[k + 1, 0], work[hi, 1] - work[k + 1, 1]
            bend = 0.0
            if ax * ax + ay * ay > 0.25 * rule[2] * rule[2] and bx * bx + by * by > 0.25 * rule[2] * rule[2]:
                bend = abs(np.arctan2(ax * by - ay * bx, ax * bx + ay * by)) / (0.5 * np.pi)
            step = np.hypot(work[k + 1, 0] - work[k, 0], work[k + 1, 1] - work[k, 1])
            work[k + 1, 2] = work[k, 2] + step * (1.0 + rule[3] * bend * bend + short)
        total += work[end, 2]
        begin = end + 1
    return total


@njit("f8(i8, i8, f8, f8[:,::1])", cache=True, nogil=True)
def stretch_for(count, wanted, total, work):
    """Return the saliency of a stretch by which there are `wanted` of them, by bisection.

    Their number falls as the stretch grows.
    """
    low, high = 0.0, total + 1e-9
    for _ in range(30):
        middle = 0.5 * (low + high)
        number = 0
        for k in range(count):
            if k == count - 1 or work[k + 1, 3] != work[k, 3]:
                number += int(work[k, 2] / middle) + 1
        if number > wanted:
            low = middle
        else:
            high = middle
    return high


@njit("i8(f8[:,::1], i8, f8, f8[:,::1], i8[::1], f8[:,::1])", cache=True, nogil=True)
def gather(points, count, stretch, out, members, work):
    """Write the mean of the points of each stretch; return how many there are."""
    written = 0
    begin = 0
    while begin < count:
        end = begin
        while end + 1 < count and work[end + 1, 3] == work[begin, 3]:
            end += 1
        number = int(work[end, 2] / stretch) + 1
        each = work[end, 2] / number + 1e-12
        k = begin
        while k <= end:
            bin_ = min(int(work[k, 2] / each), number - 1)
            sx = sy = 0.0
            n = 0
            while k <= end and min(int(work[k, 2] / each), number - 1) == bin_:
                sx += points[k, 0]
                sy += points[k, 1]
                n += 1
                k += 1
            out[written, 0] = sx / n
            out[written, 1] = sy / n
            members[written] = n
            written += 1
        begin = end + 1
    return written


@njit("i8(f8[:,::1], i8[::1], i8, f8, i8, f8[::1], f8[:,::1], i8[::1], f8[:,::1])", cache=True, nogil=True)
def resample(points, beams, count, increment_rad, wanted, rule, out, members, work):
    """Write the means of about `wanted` stretches of equal saliency into `out`; return their number.

    `work` (N, 4) keeps smoothed x, y, saliency up to the point, and the piece's number.
    `members` (N,) how many points each mean has.
    `rule`: steepness at which a surface still holds together, range noise (m), support of the bend (m),
        weight of a bend, weight of shortness, length (m) under which a piece is short.
    """
    if count == 0:
        return 0
    cut(points, beams, count, increment_rad, rule, work)
    smooth(points, count, work)
    total = weigh(count, rule, work)
    return gather(points, count, stretch_for(count, wanted, total, work), out, members, work)
