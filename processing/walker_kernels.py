"""Compiled inner loop of following small things: see `processing.walkers`.

Things are rows of an array (T, 14): place relative to the laser on the odometry's axes (x, y), fading sums
over its sights of 1, t, t^2, x, y, t x, t y, x^2 + y^2 with t = 0 now, age, time since it was seen, time for
which it was seen to stand, kind. Those in sight come first, in the order of their first points.
"""

import numpy as np
from numba import njit

SMALL_M = 1.0
"""What is seen of a person is smaller, whatever he carries; walls are longer."""
APART_M = 0.5
"""Small surfaces nearer than this are one thing: two legs, a bag."""
FAR_M = 6.0
"""Farther away a cheap laser sees too little of a thing to follow it."""
STRIDE_M = 0.5
"""How far a thing may be from where it was expected."""
WALKERS_STRIDE_M = 0.8
"""The same for one that walks: legs hide each other, and people turn."""
HIDDEN_S = 1.0
"""For how long a walker that nobody sees is remembered."""
WATCH_S = 0.5
"""A thing is followed for so long before anything is said of it."""
MEMORY_S = 0.75
"""Sights fade over so long."""
LATCH_S = 1.5
"""What has walked stands only after so much time in which it was seen to."""
SURE_M_S = 0.25
"""Two sigmas of a thing's speed, up to which it is known."""
WALKS_M_S = 0.5
"""Speed from which a thing walks, where the laser's own is known."""
FAST_M_S, FASTER = 0.5, 1.25
"""A laser whose speed is not seen goes no faster than this, or than so many times its fastest so far,"""
ODD_M_S = 0.15
"""give or take so much; one that went ahead may have slowed down or stopped, but has not turned back."""

WALL, STANDS, NEW, WALKS = 0, 1, 2, 3
"""Of walls; of small things that stand, of which nothing is known yet, and that walk."""
SUMS, AGE, HIDDEN, STOOD, KIND, WIDTH = 2, 10, 11, 12, 13, 14
"""Columns of a thing."""


@njit("i8(f8[:,::1], f8[::1], i8[::1])", cache=True, nogil=True)
def things_of(points, spans_m, numbers):
    """Write which small thing each point (N, 2) is of, -1 for walls and what is far; return their number.

    `spans_m` (N,): how far the surface of each reaches.
    """
    count = points.shape[0]
    small = np.empty(count, np.int64)
    waiting = np.empty(count, np.int64)
    left = 0
    for k in range(count):
        numbers[k] = -1
        if spans_m[k] < SMALL_M and np.hypot(points[k, 0], points[k, 1]) < FAR_M:
            small[left] = k
            left += 1
    things = 0
    for i in range(left):
        if numbers[small[i]] >= 0:
            continue
        numbers[small[i]] = things
        waiting[0], stack = small[i], 1
        while stack > 0:
            stack -= 1
            a = waiting[stack]
            for j in range(i + 1, left):
                b = small[j]
                dx, dy = points[a, 0] - points[b, 0], points[a, 1] - points[b, 1]
                if numbers[b] < 0 and np.hypot(dx, dy) < APART_M:
                    numbers[b] = things
                    waiting[stack] = b
                    stack += 1
        things += 1
    # A wall in pieces is no small thing.
    box = np.empty((things, 4))
    for n in range(things):
        box[n, 0] = box[n, 1] = np.inf
        box[n, 2] = box[n, 3] = -np.inf
    for i in range(left):
        x, y = points[small[i], 0], points[small[i], 1]
        n = numbers[small[i]]
        box[n, 0], box[n, 1] = min(box[n, 0], x), min(box[n, 1], y)
        box[n, 2], box[n, 3] = max(box[n, 2], x), max(box[n, 3], y)
    kept = 0
    for n in range(things):
        whole = np.hypot(box[n, 2] - box[n, 0], box[n, 3] - box[n, 1]) < SMALL_M
        box[n, 0] = kept if whole else -1
        kept += whole
    for i in range(left):
        numbers[small[i]] = int(box[numbers[small[i]], 0])
    return kept


@njit("f8(f8[::1], f8[::1])", cache=True, nogil=True)
def speed_of(thing, speed):
    """Write the velocity (2,) at which the laser sees a thing pass; return its standard deviation."""
    one, t, tt = max(thing[SUMS], 1e-12), thing[SUMS + 1], thing[SUMS + 2]
    x, y = thing[SUMS + 3], thing[SUMS + 4]
    spread = max(tt - t * t / one, 1e-12)
    speed[0] = (thing[SUMS + 5] - t * x / one) / spread
    speed[1] = (thing[SUMS + 6] - t * y / one) / spread
    rest = thing[SUMS + 7] - (x * x + y * y) / one - spread * (speed[0] * speed[0] + speed[1] * speed[1])
    return np.sqrt(max(rest, 0.0) / one / spread)


@njit("void(f8[:,::1], f8[::1], f8)", cache=True, nogil=True)
def move_on(things, velocity, duration_s):
    """Let time pass: those who walk go on as they did, everything else as if it stood."""
    fade, speed = np.exp(-duration_s / MEMORY_S), np.empty(2)
    for k in range(things.shape[0]):
        thing = things[k]
        speed[0], speed[1] = -velocity[0], -velocity[1]
        if thing[KIND] == WALKS:
            speed_of(thing, speed)
        thing[0] += duration_s * speed[0]
        thing[1] += duration_s * speed[1]
        one, t, tt = thing[SUMS], thing[SUMS + 1], thing[SUMS + 2]
        x, y, tx, ty = thing[SUMS + 3], thing[SUMS + 4], thing[SUMS + 5], thing[SUMS + 6]
        thing[SUMS] = fade * one
        thing[SUMS + 1] = fade * (t - duration_s * one)
        thing[SUMS + 2] = fade * (tt - 2.0 * duration_s * t + duration_s * duration_s * one)
        thing[SUMS + 3] = fade * x
        thing[SUMS + 4] = fade * y
        thing[SUMS + 5] = fade * (tx - duration_s * x)
        thing[SUMS + 6] = fade * (ty - duration_s * y)
        thing[SUMS + 7] = fade * thing[SUMS + 7]
        thing[AGE] += duration_s
        thing[HIDDEN] += duration_s


@njit("void(f8[:,::1], f8[:,::1], i8[::1])", cache=True, nogil=True)
def associate(at, things, same):
    """Write which of the known things each of those at (M, 2) is, nearest pairs first; -1 for new ones."""
    taken = np.zeros(things.shape[0], np.bool_)
    for i in range(at.shape[0]):
        same[i] = -1
    while True:
        nearest, new, old = WALKERS_STRIDE_M, -1, -1
        for i in range(at.shape[0]):
            if same[i] >= 0:
                continue
            for j in range(things.shape[0]):
                if taken[j]:
                    continue
                off = np.hypot(at[i, 0] - things[j, 0], at[i, 1] - things[j, 1])
                if things[j, KIND] != WALKS:
                    off *= WALKERS_STRIDE_M / STRIDE_M
                if off < nearest:
                    nearest, new, old = off, i, j
        if new < 0:
            return
        same[new], taken[old] = old, True


@njit("void(f8[::1], f8[::1], f8, f8[:,::1], f8)", cache=True, nogil=True)
def judge(thing, velocity, fastest_m_s, unseen, duration_s):
    """Tell whether a thing in sight walks, as far as it has been followed.

    As fast as a standing thing passes, the other way, goes the laser: along `unseen` (K, 2) anything that it
    can, elsewhere with `velocity` (2,).
    """
    passing = np.empty(2)
    slack = 2.0 * speed_of(thing, passing)
    laser_x, laser_y = -passing[0], -passing[1]
    # Out by how much, in the direction where it is out by most: what is neither clearly is not known.
    out = 0.0
    off_x, off_y = laser_x - velocity[0], laser_y - velocity[1]
    fast = max(FAST_M_S, FASTER * fastest_m_s) + ODD_M_S
    for k in range(unseen.shape[0]):
        dx, dy = unseen[k, 0], unseen[k, 1]
        usual = dx * velocity[0] + dy * velocity[1]
        low = -fast if usual < ODD_M_S else -ODD_M_S
        high = fast if usual > -ODD_M_S else ODD_M_S
        along = dx * laser_x + dy * laser_y
        out = max(out, low - along, along - high)
        aside = dx * off_x + dy * off_y
        off_x -= aside * dx
        off_y -= aside * dy
    out = max(out, np.hypot(off_x, off_y) - WALKS_M_S)
    if thing[AGE] < WATCH_S - 1e-6 or slack > SURE_M_S:
        return
    if out > slack:
        thing[STOOD], thing[KIND] = 0.0, WALKS
    elif out <= 0.0:
        thing[STOOD] += duration_s
        if thing[STOOD] >= LATCH_S:
            thing[KIND] = STANDS


@njit("void(f8[:,::1], i8, f8[:,::1], i8)", cache=True, nogil=True)
def take_over(things, old, after, new):
    """Copy a row; a slice assigned to a slice would take seconds longer to compile."""
    for m in range(WIDTH):
        after[new, m] = things[old, m]


@njit(
    "f8[:,::1](f8[:,::1], f8[::1], f8, f8[::1], f8, f8[:,::1], f8, f8[:,::1], i8[::1], i8[::1])",
    cache=True,
    nogil=True,
)
def look(points, spans_m, yaw_rad, velocity, fastest_m_s, unseen, duration_s, things, numbers, kinds):
    """Return the things after the next scan; write of which each point (N, 2) is, and its kind, (N,) each."""
    move_on(things, velocity, duration_s)
    count = things_of(points, spans_m, numbers)
    at, members = np.zeros((count, 2)), np.zeros(count)
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    for k in range(points.shape[0]):
        if numbers[k] >= 0:
            at[numbers[k], 0] += c * points[k, 0] - s * points[k, 1]
            at[numbers[k], 1] += s * points[k, 0] + c * points[k, 1]
            members[numbers[k]] += 1.0
    same = np.empty(count, np.int64)
    for k in range(count):
        at[k, 0] /= members[k]
        at[k, 1] /= members[k]
    associate(at, things, same)
    hidden = np.ones(things.shape[0], np.bool_)
    for k in range(count):
        if same[k] >= 0:
            hidden[same[k]] = False
    kept = count
    for j in range(things.shape[0]):
        hidden[j] &= things[j, KIND] == WALKS and things[j, HIDDEN] < HIDDEN_S
        kept += hidden[j]
    after = np.zeros((kept, WIDTH))
    for k in range(count):
        thing, x, y = after[k], at[k, 0], at[k, 1]
        if same[k] >= 0:
            take_over(things, same[k], after, k)
        else:
            # The second leg of one who walks is no new thing.
            thing[STOOD], thing[KIND] = LATCH_S, NEW
            for j in range(things.shape[0]):
                near = np.hypot(x - things[j, 0], y - things[j, 1]) < STRIDE_M
                if near and things[j, KIND] == WALKS:
                    thing[STOOD], thing[KIND] = 0.0, WALKS
        thing[0], thing[1], thing[HIDDEN] = x, y, 0.0
        thing[SUMS] += 1.0
        thing[SUMS + 3] += x
        thing[SUMS + 4] += y
        thing[SUMS + 7] += x * x + y * y
        judge(thing, velocity, fastest_m_s, unseen, duration_s)
    kept = count
    for j in range(things.shape[0]):
        if hidden[j]:
            take_over(things, j, after, kept)
            kept += 1
    for k in range(points.shape[0]):
        kinds[k] = WALL if numbers[k] < 0 else int(after[numbers[k], KIND])
    return after
