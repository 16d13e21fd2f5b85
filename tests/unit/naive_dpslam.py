"""The mapper's naive twin: every particle owns a whole map, and a selection copies whole maps.

No tiles, no sharing, no tree, no block that is kept: dense arrays, lists of poses, plain loops. What it
shares with the real one are the numbers of the models, the sweeps and the random stream. Sums run in the same
order, so that results can be compared bit for bit; scalar functions are those of the C library, as compiled
code calls them.
"""

import math

import numpy as np

from processing import se2
from processing.dpslam import alignment, laser_model, population, writing
from processing.dpslam.config import DpSlamConfig
from processing.dpslam.grid import BLOCK, BLOCK_M, CELL_M, METRES, PLACES, STOPS
from processing.dpslam.proposal import doubted, held, noise_root, priors
from processing.dpslam.resampling import normalise
from processing.dpslam.sweep import Sweeper
from processing.motion import carried

HALF = 320
"""The dense maps reach so many cells from the start."""


def cells_of(x0, y0, x1, y1):
    """Walk from one point to another (in cells); yield column, row, and where the ray enters and leaves."""

    def axis(start, end):
        cell, d = math.floor(start), end - start
        if d > 0.0:
            return cell, 1, (cell + 1.0 - start) / d, 1.0 / d
        if d < 0.0:
            return cell, -1, (cell - start) / d, -1.0 / d
        return cell, 0, math.inf, math.inf

    col, step_x, next_x, way_x = axis(x0, x1)
    row, step_y, next_y, way_y = axis(y0, y1)
    at = 0.0
    while True:
        last = next_x >= 1.0 and next_y >= 1.0
        until = 1.0 if last else min(next_x, next_y)
        yield col, row, at, until, last
        if last:
            return
        at = until
        if next_x <= next_y:
            col, next_x = col + step_x, next_x + way_x
        else:
            row, next_y = row + step_y, next_y + way_y


def placed(pose, rays):
    c, s = math.cos(pose[2]), math.sin(pose[2])
    out = []
    for x0, y0, x1, y1 in rays.tolist():
        out.append(
            (
                c * x0 - s * y0 + pose[0],
                s * x0 + c * y0 + pose[1],
                c * x1 - s * y1 + pose[0],
                s * x1 + c * y1 + pose[1],
            )
        )
    return out


class NaiveMap:
    """One particle's whole map: stops, metres, mean end points of every cell, in the units of the store."""

    def __init__(self):
        self.cells = np.zeros((2 * HALF, 2 * HALF, 4), dtype=np.uint16)

    def copy(self):
        other = NaiveMap()
        other.cells = self.cells.copy()
        return other

    def write(self, rays_map, memory):
        per_m = 20.0
        for x0, y0, x1, y1 in rays_map:
            u0, v0, u1, v1 = x0 * per_m, y0 * per_m, x1 * per_m, y1 * per_m
            length = float(np.hypot(u1 - u0, v1 - v0)) * CELL_M
            for col, row, at, until, last in cells_of(u0, v0, u1, v1):
                cell = self.cells[row + HALF, col + HALF]
                stops, metres, x, y = (int(v) for v in cell)
                metres += int((until - at) * length * METRES + 0.5)
                if last:
                    stops += int(STOPS)
                    new_x = min(max((u1 - col) * PLACES, 0.0), PLACES - 1.0)
                    new_y = min(max((v1 - row) * PLACES, 0.0), PLACES - 1.0)
                    cell[2] = int(x + (new_x - x) * (STOPS / stops) + 0.5)
                    cell[3] = int(y + (new_y - y) * (STOPS / stops) + 0.5)
                seen = stops / STOPS + metres * (per_m / METRES)
                if stops > 0 and seen > memory:
                    stops, metres = int(stops * (memory / seen)), int(metres * (memory / seen))
                cell[0], cell[1] = stops, min(metres, int(memory * CELL_M * METRES))

    def log_likelihood(self, rays_map, every, whole, unseen=0.0):
        m = laser_model
        total = 0.0
        for x0, y0, x1, y1 in rays_map[::every]:
            reading = float(np.hypot(x1 - x0, y1 - y0))
            dx, dy = (x1 - x0) / reading, (y1 - y0) / reading
            start = 0.0 if whole else max(0.0, reading - m.NEAR_M)
            length = reading + m.NEAR_M - start
            ends = (x0 + start * dx, y0 + start * dy, x0 + (start + length) * dx, y0 + (start + length) * dy)
            depth = likelihood = 0.0
            through, frontier = None, False
            for col, row, at, until, _last in cells_of(*(v * 20.0 for v in ends)):
                stops, metres = (int(v) for v in self.cells[row + HALF, col + HALF, :2])
                units = METRES / STOPS
                density = (stops * units + m.PRIOR_STOPS * METRES) / (metres + m.PRIOR_M * METRES)
                if stops == metres == 0:
                    density = m.PRIOR_DENSITY
                thick = density * ((until - at) * length)
                off = (start + 0.5 * (at + until) * length - reading) * (1.0 / m.NEAR_M)
                near = 1.0 - off * off
                if near > 0.0:
                    through = math.exp(-depth) if through is None else through
                    passed = through * math.exp(-thick)
                    near *= near
                    near *= near
                    if metres == 0 and not frontier:
                        frontier = True
                        likelihood += unseen * through * (near * near if off > 0.0 else 1.0)
                    likelihood += (through - passed) * (near * near)
                    through = passed
                elif through is not None:
                    break
                else:
                    depth += thick
                    if depth > m.OPAQUE:
                        break
            total += math.log(m.FLOOR + likelihood)
        return total

    def known(self, rays_map):
        """Share of the rays that end where the map knows something, and their mean log-likelihood."""
        known = []
        for ray in rays_map:
            col, row = math.floor(ray[2] * 20.0), math.floor(ray[3] * 20.0)
            if self.cells[row + HALF, col + HALF, 1] > 0:
                known.append(self.log_likelihood([ray], 1, True))
        return len(known) / len(rays_map), sum(known) / max(len(known), 1)

    def contradicts(self, rays_map):
        """Whether many rays end where the map knows something, and does not know it so."""
        share, fit = self.known(rays_map)
        return share >= population.KNOWN and fit < population.MISFIT

    def block(self, row, col):
        """Moments of the occupied cells of one block, in single precision as the store keeps them."""
        moments = [0.0] * 6
        for r in range(BLOCK):
            for c in range(BLOCK):
                cell = self.cells[row * BLOCK + r + HALF, col * BLOCK + c + HALF]
                stops, metres = int(cell[0]) / STOPS, int(cell[1]) / METRES
                density = (stops + laser_model.PRIOR_STOPS) / (metres + laser_model.PRIOR_M)
                if stops <= 0.0 or 1.0 - math.exp(-density * CELL_M) < laser_model.OCCUPIED:
                    continue
                w = min(stops, writing.MOST_WEIGHT)
                x, y = (c + int(cell[2]) / PLACES) * CELL_M, (r + int(cell[3]) / PLACES) * CELL_M
                for k, value in enumerate((w, w * x, w * y, w * x * x, w * x * y, w * y * y)):
                    moments[k] += value
        return [float(np.float32(v)) for v in moments]

    def normal(self, row, col):
        """Mean and inverse covariance of an NDT cell of 2 x 2 blocks; None if it holds too little."""
        n = sx = sy = sxx = sxy = syy = 0.0
        for j in range(2):
            for i in range(2):
                b = self.block(row + j, col + i)
                w = b[0]
                if w <= 0.0:
                    continue
                ox, oy = i * BLOCK_M, j * BLOCK_M
                n += w
                sx += b[1] + w * ox
                sy += b[2] + w * oy
                sxx += b[3] + 2.0 * ox * b[1] + w * ox * ox
                sxy += b[4] + ox * b[2] + oy * b[1] + w * ox * oy
                syy += b[5] + 2.0 * oy * b[2] + w * oy * oy
        if n < alignment.LEAST_WEIGHT:
            return None
        mx, my = sx / n, sy / n
        xx, xy, yy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
        middle, half = 0.5 * (xx + yy), float(np.hypot(0.5 * (xx - yy), xy))
        long, short = middle + half, max(middle - half, 0.0)
        angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
        c, s = math.cos(angle), math.sin(angle)
        wall = long > alignment.LONG * max(short, alignment.THINNEST_M2)
        short = max(short, 0.001 * long, alignment.LEAST_SPREAD_M * alignment.LEAST_SPREAD_M)
        long = max(long, short)
        if wall:
            long *= alignment.STRETCH
        a, b = 1.0 / long, 1.0 / short
        return mx, my, a * c * c + b * s * s, (a - b) * c * s, a * s * s + b * c * c

    def align(self, points, predicted, prior, gain):
        """Pose (3,) of the optimum, and the information (3, 3) of the scan near it."""
        normals = {}
        pose = [float(v) for v in predicted]
        for iteration in range(alignment.ITERATIONS + 1):
            c, s = math.cos(pose[2]), math.sin(pose[2])
            g, h = [0.0] * 3, [0.0] * 6
            for x, y in points.tolist():
                rx, ry = c * x - s * y, s * x + c * y
                u, v = (pose[0] + rx) / BLOCK_M, (pose[1] + ry) / BLOCK_M
                for j in range(2):
                    for k in range(2):
                        row, col = math.floor(v) - j, math.floor(u) - k
                        if (row, col) not in normals:
                            normals[row, col] = self.normal(row, col)
                        n = normals[row, col]
                        if n is None:
                            continue
                        qx, qy = (u - col) * BLOCK_M - n[0], (v - row) * BLOCK_M - n[1]
                        wx, wy = n[2] * qx + n[3] * qy, n[3] * qx + n[4] * qy
                        m = qx * wx + qy * wy
                        if m > 30.0:
                            continue
                        e = math.exp(-0.5 * m) / 4
                        wa = -ry * wx + rx * wy
                        ax, ay = -ry * n[2] + rx * n[3], -ry * n[3] + rx * n[4]
                        for index, value in enumerate((e * wx, e * wy, e * wa)):
                            g[index] += value
                        terms = (e * n[2], e * n[3], e * n[4], e * ax, e * ay, e * (-ry * ax + rx * ay))
                        for index, value in enumerate(terms):
                            h[index] += value
            if iteration == alignment.ITERATIONS:
                break
            step = _newton(pose, predicted, prior, gain, g, h)
            pose = [p + d for p, d in zip(pose, step, strict=True)]
            if abs(step[0]) < 1e-4 and abs(step[1]) < 1e-4 and abs(step[2]) < 1e-5:
                break
        pose[2] = (pose[2] + math.pi) % (2.0 * math.pi) - math.pi
        rows = ((h[0], h[1], h[3]), (h[1], h[2], h[4]), (h[3], h[4], h[5]))
        return np.array(pose), gain * np.array(rows)


def _newton(pose, predicted, prior, gain, g, h):
    d0, d1 = pose[0] - predicted[0], pose[1] - predicted[1]
    d2 = (pose[2] - predicted[2] + math.pi) % (2.0 * math.pi) - math.pi
    a00, a01, a11 = gain * h[0] + prior[0, 0], gain * h[1] + prior[0, 1], gain * h[2] + prior[1, 1]
    a02, a12, a22 = gain * h[3] + prior[0, 2], gain * h[4] + prior[1, 2], gain * h[5] + prior[2, 2]
    b0 = gain * g[0] + prior[0, 0] * d0 + prior[0, 1] * d1 + prior[0, 2] * d2
    b1 = gain * g[1] + prior[0, 1] * d0 + prior[1, 1] * d1 + prior[1, 2] * d2
    b2 = gain * g[2] + prior[0, 2] * d0 + prior[1, 2] * d1 + prior[2, 2] * d2
    m00, m01, m02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    m11, m12, m22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    det = a00 * m00 + a01 * m01 + a02 * m02
    return (
        -(m00 * b0 + m01 * b1 + m02 * b2) / det,
        -(m01 * b0 + m11 * b1 + m12 * b2) / det,
        -(m02 * b0 + m12 * b1 + m22 * b2) / det,
    )


class NaiveDpSlam:
    """DP-SLAM as one would write it first: P maps, P paths, copied whole when a particle has descendants."""

    def __init__(self, config: DpSlamConfig, seed: int):
        self.config, self.seed = config, seed
        self.maps = [NaiveMap() for _ in range(config.particles)]
        self.paths = [[] for _ in range(config.particles)]
        self.poses = np.zeros((config.particles, 3))
        self.log_weights = np.full(config.particles, -np.log(config.particles))
        self.best = 0
        self.keys = 0
        self.sweeps = []
        self.odom = self.key_odom = None
        self.selections = 0
        self.old_ground = True

    def step(self, scan, motion):
        odom = motion.odom_t_laser
        if self.odom is None:
            self.sweeper = Sweeper(scan.beams, self.config.points, self.config.range_max_m)
            self.key_odom, self.covariance = odom, np.zeros((3, 3))
        else:
            step = se2.between(self.odom, odom)
            self.covariance = carried(self.covariance, step)
            self.covariance += doubted(motion.covariance, self.config.motion_doubt)
        first, self.odom = self.odom is None, odom
        moved = se2.between(self.key_odom, odom)
        c = self.config
        if not first and np.hypot(*moved[:2]) < c.key_distance_m and abs(moved[2]) < c.key_rotation_rad:
            return False
        sweep = self.sweeper.take(scan, motion)
        rays = sweep.rays
        if not first:
            if self._update(sweep, moved):
                rays = rays[:0]
        else:
            for path, pose in zip(self.paths, self.poses, strict=True):
                path.append(pose)
        self.keys += 1
        self.sweeps.append(rays)
        for own_map, pose in zip(self.maps, self.poses, strict=True):
            own_map.write(placed(pose, rays), c.memory)
        self.key_odom, self.covariance = odom, np.zeros((3, 3))
        return True

    def relive(self, path):
        offsets = se2.between(self.poses[self.best], self.poses)
        self.poses = se2.compose(path[-1], offsets)
        self.paths = [[*path[:-1], pose] for pose in self.poses]
        drawn = NaiveMap()
        for pose, rays in zip(path, self.sweeps, strict=True):
            drawn.write(placed(pose, rays), self.config.memory)
        self.maps = [drawn.copy() for _ in self.poses]

    def _update(self, sweep, moved):
        c = self.config
        count = c.particles
        random = np.random.Generator(np.random.Philox(key=self.seed, counter=(0, 0, 0, self.keys)))
        normal, uniform = random.standard_normal((count, 3)), random.random()
        normal[self.best] = 0.0
        root = noise_root(self.covariance)
        predicted = se2.compose(se2.compose(self.poses, moved), normal @ root.T)
        ties = priors(root, c.prior_m, c.prior_rad, predicted[:, 2])
        aligned = [
            own_map.align(sweep.points, pose, prior, population.GAIN)
            for own_map, pose, prior in zip(self.maps, predicted, ties, strict=True)
        ]
        poses, informations = (np.stack(parts) for parts in zip(*aligned, strict=True))
        self.poses, blind = held(poses, predicted, informations / population.GAIN)
        rays = sweep.rays[:: max(1, len(sweep.rays) // c.rays)]
        seen = [placed(pose, rays) for pose in self.poses]
        if self.old_ground and not blind @ np.exp(self.log_weights) > 0.5:
            self._weigh(rays, seen)
        heaviest = int(np.argmax(self.log_weights))
        if self.log_weights[heaviest] > self.log_weights[self.best] + population.FAITH:
            self.best = heaviest
        misfit = self.maps[self.best].contradicts(seen[self.best])
        for path, pose in zip(self.paths, self.poses, strict=True):
            path.append(pose)
        if not self.old_ground:
            if self.keys % population.MIX_EVERY == 0:
                self._select(uniform, self.log_weights + population.MIX * random.standard_normal(count))
        elif 1.0 / np.exp(2.0 * self.log_weights).sum() < count / 2:
            self._select(uniform, self.log_weights)
        return misfit

    def _weigh(self, rays, seen):
        c = self.config
        share, fit = self.maps[self.best].known(seen[self.best])
        known, few = share * len(rays), population.NEUTRAL_RAYS
        usual = float(np.exp((known * fit + few * population.NEUTRAL) / (known + few)))
        pairs = list(zip(self.maps, seen, strict=True))
        cheap = np.array([own_map.log_likelihood(r, 3, False, usual) for own_map, r in pairs])
        estimate = self.log_weights + c.tempering * 3.0 * cheap
        weights = np.full(c.particles, -1e300)
        for i in np.flatnonzero(estimate >= estimate.max() - population.NEGLIGIBLE):
            full = self.maps[i].log_likelihood(seen[i], 1, True, usual)
            weights[i] = self.log_weights[i] + c.tempering * full
        peak = weights.max()
        self.log_weights = weights - (peak + np.log(np.exp(weights - peak).sum()))

    def _select(self, uniform, chances):
        count = self.config.particles
        edges = np.cumsum(np.exp(normalise(chances)))
        edges /= edges[-1]
        children = [0] * count
        for k in range(count):
            at = min((uniform + k) / count, np.nextafter(1.0, 0.0))
            children[int(np.searchsorted(edges, at, side="right"))] += 1
        # Survivors keep their places, and the others take those of the dead, in order.
        spare = [i for i in range(count) for _ in range(children[i] - 1)]
        parents = [i if children[i] else spare.pop(0) for i in range(count)]
        after = np.full(count, -np.log(count))
        if parents[self.best] != self.best:
            # The best one lives on, in its place and with its weight.
            parents[self.best] = self.best
            after[:] = np.log((1.0 - np.exp(self.log_weights[self.best])) / (count - 1))
            after[self.best] = self.log_weights[self.best]
        self.maps = [self.maps[p].copy() for p in parents]
        self.paths = [list(self.paths[p]) for p in parents]
        self.poses = self.poses[parents]
        self.log_weights = after
        self.selections += 1
