"""Plain twins of the compiled loops of the laser odometry: slow, and nothing shared with them."""

import numpy as np

MASK = 2**64 - 1


class Random:
    """SplitMix64 in whole numbers."""

    def __init__(self, seed):
        self.state = seed

    def uniform(self):
        self.state = (self.state + 0x9E3779B97F4A7C15) & MASK
        z = self.state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
        return ((z ^ (z >> 31)) >> 11) / 2**53

    def below(self, count):
        return int(self.uniform() * count)

    def other_than(self, taken, count):
        while (drawn := self.below(count)) in taken:
            pass
        return drawn


def scatter(size, bounds, random):
    """Latin hypercube: each axis gets one member in each of its slices, in an order of its own."""
    columns = []
    for low, high in bounds.T:
        column = [low + (i + random.uniform()) * ((high - low) / size) for i in range(size)]
        for i in range(size - 1, 0, -1):
            j = random.below(i + 1)
            column[i], column[j] = column[j], column[i]
        columns.append(column)
    return np.array(columns).T


def propose(population, i, bounds, factor, crossover, random):
    """DE/rand/1/bin: three members, each other than the rest and than i; a value outside bounces back."""
    size, dimensions = population.shape
    a = random.other_than({i}, size)
    b = random.other_than({i, a}, size)
    c = random.other_than({i, a, b}, size)
    mutant = population[a] + factor * (population[b] - population[c])
    forced = random.below(dimensions)
    trial = population[i].copy()
    for d in range(dimensions):
        if random.uniform() < crossover or d == forced:
            low, high, base = bounds[0, d], bounds[1, d], population[a, d]
            trial[d] = mutant[d]
            if mutant[d] < low:
                trial[d] = low + random.uniform() * (base - low)
            elif mutant[d] > high:
                trial[d] = high - random.uniform() * (high - base)
    return trial


def evolve(objective, bounds, config, seed):
    """The whole search without early ends: members (NP, D) and their values after all generations."""
    random = Random(seed)
    population = scatter(config.population, bounds, random)
    values = np.array([objective(member) for member in population])
    for _ in range(config.generations):
        trials = [
            propose(population, i, bounds, config.factor, config.crossover, random)
            for i in range(config.population)
        ]
        for i, trial in enumerate(trials):
            if objective(trial) >= values[i]:
                population[i], values[i] = trial, objective(trial)
    return population, values


class Ndt:
    """Four grids of cells, each shifted by half a cell; cells of a grid are numbered from its own corner."""

    SHIFTS = ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5))

    def __init__(self, points, config):
        self.config = config
        self.cells = []
        for shift in self.SHIFTS:
            members = {}
            for point, place in zip(points, self._places(points, shift), strict=True):
                members.setdefault(place, []).append(point)
            self.cells.append(
                {
                    place: self._normal(np.array(own))
                    for place, own in members.items()
                    if len(own) >= config.min_points
                }
            )

    def _places(self, points, shift):
        return [tuple(np.floor(point / self.config.cell_m - shift).astype(int)) for point in points]

    def _normal(self, points):
        c = self.config
        small, large = np.linalg.eigh(np.cov(points.T, bias=True))[0]
        vectors = np.linalg.eigh(np.cov(points.T, bias=True))[1]
        flat = max(small, 1e-6) < c.flat_ratio * large
        large = max(large, c.min_deviation_m**2)
        small = max(small, c.min_deviation_m**2, c.min_ratio * large)
        if flat:
            large *= c.flat_stretch
        return points.mean(axis=0), vectors @ np.diag((small, large)) @ vectors.T

    def score(self, points, pose, blur_m2=0.0, weighed_at=None):
        """Sum of the weighted means of four densities; weights and normals may be those of another pose."""
        weighed_at = pose if weighed_at is None else weighed_at
        turn = np.array((0.0, 0.0, weighed_at[2]))
        normals = _moved(points[:, 2:], turn) if points.shape[1] == 4 else [np.zeros(2)] * len(points)
        moved, weighed = (_moved(points[:, :2], at) for at in (pose, weighed_at))
        return sum(
            self.point_score(point, blur_m2, *rest)
            for point, *rest in zip(moved, weighed, normals, strict=True)
        )

    def knows(self, point):
        """Whether any of the four cells around a point holds enough."""
        return any(
            self._places([point], shift)[0] in cells
            for shift, cells in zip(self.SHIFTS, self.cells, strict=True)
        )

    def point_score(self, point, blur_m2=0.0, weighed=None, normal=None):
        weighed = point if weighed is None else weighed
        total = weights = 0.0
        for shift, cells in zip(self.SHIFTS, self.cells, strict=True):
            place = self._places([weighed], shift)[0]
            if place not in cells:
                continue
            mean, covariance = cells[place]
            middle = (np.array(place) + shift + 0.5) * self.config.cell_m
            weight = np.prod(1.0 - np.abs(weighed - middle) / (0.5 * self.config.cell_m))
            weights += weight
            total += weight * _density(point - mean, covariance + blur_m2 * np.eye(2), normal)
        return total / weights if weights > 1e-9 else 0.0


def _density(off, covariance, normal):
    """Of a point with the unit normal of its wall, None or 0 for none."""
    if normal is None or not normal.any():
        return np.exp(-0.5 * off @ np.linalg.inv(covariance) @ off)
    (small, large), vectors = np.linalg.eigh(covariance)
    if small * large < 0.01 * (small + large) ** 2:
        # A wall: the point is on it, and tells what every point tells, or on one that runs otherwise.
        across, along = small**-1, large**-1
        facing = normal @ vectors
        if across * facing[0] ** 2 + along * facing[1] ** 2 < 0.5 * (across + along):
            return 0.0
        return np.exp(-0.5 * off @ np.linalg.inv(covariance) @ off)
    return np.exp(-0.5 * (normal @ off) ** 2 / (normal @ covariance @ normal))


def _moved(points, pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return [np.array((c * x - s * y + pose[0], s * x + c * y + pose[1])) for x, y in points]


class Resampled:
    """Means of stretches of equal saliency, piece by piece, of points (N, 2) from rays of these numbers."""

    def __init__(self, points, rays, increment_rad, config):
        self.config = config
        self.pieces = self._split(points, rays, increment_rad) if len(points) else []
        self.saliencies = [self._saliency(self._smooth(piece)) for piece in self.pieces]
        self.means, self.members = self._cut(self._stretch())

    def _split(self, points, rays, increment_rad):
        c = self.config
        pieces = [[points[0]]]
        for k in range(1, len(points)):
            gap = rays[k] - rays[k - 1]
            near = min(np.linalg.norm(points[k]), np.linalg.norm(points[k - 1]))
            most = c.max_slant * near * increment_rad * gap + 3.0 * c.range_noise_m
            if gap > 4 or np.linalg.norm(points[k] - points[k - 1]) > most:
                pieces.append([])
            pieces[-1].append(points[k])
        return [np.array(piece) for piece in pieces]

    def _smooth(self, piece):
        last = len(piece) - 1
        reaches = [min(2, k, last - k) for k in range(len(piece))]
        return np.array([piece[k - r : k + r + 1].mean(axis=0) for k, r in enumerate(reaches)])

    def _saliency(self, line):
        """Saliency up to each point of a smoothed piece: its length, longer in bends and on short pieces."""
        c = self.config
        steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
        short = c.short_weight * c.short_m / (c.short_m + steps.sum())
        grown = [0.0]
        behind = ahead = 0
        for k, step in enumerate(steps):
            # The nearest places at least one support away, or the ends; neither ever turns back.
            while behind < k and np.linalg.norm(line[k] - line[behind + 1]) >= c.bend_support_m:
                behind += 1
            ahead = max(ahead, k + 1)
            while ahead < len(steps) and np.linalg.norm(line[ahead] - line[k + 1]) < c.bend_support_m:
                ahead += 1
            bend = 0.0
            came, goes = line[k] - line[behind], line[ahead] - line[k + 1]
            if min(np.linalg.norm(came), np.linalg.norm(goes)) > 0.5 * c.bend_support_m:
                turn = np.arctan2(goes[1], goes[0]) - np.arctan2(came[1], came[0])
                bend = abs((turn + np.pi) % (2.0 * np.pi) - np.pi) / (0.5 * np.pi)
            grown.append(grown[-1] + step * (1.0 + c.bend_weight * bend**2 + short))
        return np.array(grown)

    def _stretch(self):
        """The least saliency of a stretch at which no more than the wanted number comes out, by bisection."""
        totals = np.array([grown[-1] for grown in self.saliencies])
        low, high = 0.0, totals.sum() + 1e-9
        for _ in range(30):
            middle = 0.5 * (low + high)
            if np.sum(np.floor(totals / middle) + 1) > self.config.points:
                low = middle
            else:
                high = middle
        return high

    def _cut(self, stretch):
        means, members = [], []
        for piece, grown in zip(self.pieces, self.saliencies, strict=True):
            number = int(grown[-1] / stretch) + 1
            place = np.minimum(np.floor(grown / (grown[-1] / number + 1e-12)), number - 1)
            for stretch_number in np.unique(place):
                own = piece[place == stretch_number]
                means.append(own.mean(axis=0))
                members.append(len(own))
        return np.array(means).reshape(-1, 2), members


def polish(score, prior_pose, information, trust, weight, stages, pose):
    """Levenberg and Marquardt on weight * score + log of a normal prior.

    `score(pose, blur, share)` has the derivatives.
    """
    pose = pose.copy()

    def height(found, at):
        off = at - prior_pose
        return weight * found.value - 0.5 * trust * off @ information @ off

    for stage in stages:
        found, damping = score(pose, *stage), 0.0
        for _ in range(12):
            slope = weight * found.gradient - trust * information @ (pose - prior_pose)
            brake = trust * information + damping * weight * np.diag(np.diag(found.information))
            system = brake - weight * found.hessian
            if np.linalg.eigvalsh(system).min() <= 0.0:
                system = brake + weight * found.information
            step = np.linalg.solve(system, slope)
            size, turn = np.hypot(step[0], step[1]), abs(step[2])
            trial = pose + step * min(1.0, 0.1 / max(size, 1e-12), 0.05 / max(turn, 1e-12))
            there = score(trial, *stage)
            if height(there, trial) >= height(found, pose):
                pose, found, damping = trial, there, 0.25 * damping
            else:
                damping = max(4.0 * damping, 0.5)
            if size < 1e-5 and turn < 1e-5:
                break
    return pose
