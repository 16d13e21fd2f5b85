"""What the odometry benches drive: simulated courses with their truth, and logs with relations or wheels.

Nothing is measured here. Poses of truth are of the laser at the first ray of each scan, as the stamp is.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from floor_plans import floor_plan

from drivers import world
from drivers.world.drive import simulate_scans
from processing.scan import Scan
from processing.se2 import between, compose, wrap
from runtime.formats.logs import open_log
from runtime.formats.relations import Relations, read_relations
from runtime.nodes.log_scans import beams_of, iterate
from tests.lasers import beams_of_laser
from tests.people import Peopled, Person

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
BASE_T_LASER = {"fr079": np.array((-0.04, 0.0, 0.0))}
"""Where the relations hold for the robot: the laser sits behind its frame (the data's README)."""


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Scans in order, and what is known of the way."""

    name: str
    scans: list[Scan]
    truth: np.ndarray | None = None
    """(N, 3) world_t_laser, simulated courses only."""
    relations: Relations | None = None
    wheels: np.ndarray | None = None
    """(N, 3) wheel_t_base at each scan, exp1 and exp2 only."""
    base_t_laser: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @property
    def way_m(self) -> float:
        """Length of the true way."""
        return float(np.hypot(*np.diff(self.truth[:, :2], axis=0).T).sum())


def _drive(building, **options):
    return lambda seed, laser: list(simulate_scans(building(), laser=laser, seed=seed, **options))


def _rest(building):
    """Somewhere in a building, standing still for 20 s."""

    def look(seed, laser):
        rng = np.random.default_rng(seed)
        pose = np.append(building().route[0], 0.4)
        poses = np.tile(pose, (laser.beams, 1))
        at = building()
        return [
            (10**9 + round(k * laser.period_s * 1e9), laser.measure(at, poses, rng), pose) for k in range(200)
        ]

    return look


def _among_people(seed, laser):
    """Out of a room and along a plain corridor, where two people come and one overtakes."""
    free = [(0.0, -2.0, 6.0, 3.0), (6.0, 0.0, 60.0, 2.0)]
    building = world.Building(world.outline(free), route=np.array(((2.0, 1.0), (59.0, 1.0))))
    ways = (((30.0, 1.4), (1.0, 1.4), 0.9), ((40.0, 0.7), (1.0, 0.7), 1.2), ((0.3, 0.6), (59.0, 0.6), 0.7))
    people = [Person(start=np.array(a), end=np.array(b), speed_mps=speed) for a, b, speed in ways]
    return list(simulate_scans(building, laser=Peopled(laser, people), seed=seed, speed_mps=0.4))


COURSES: dict[str, Callable] = {
    "room": _drive(world.room, speed_mps=0.4, laps=2),
    "corridor with doors": _drive(world.hallway_with_doors, speed_mps=0.5),
    "plain corridor": _drive(lambda: world.corridor(40.0, 2.0), speed_mps=0.5),
    "hall": _drive(world.pillar_hall, speed_mps=0.5),
    "demo": _drive(world.demo_building, speed_mps=0.4),
    "stand-still": _rest(world.room),
    "square of corridors": _drive(world.square_of_corridors, speed_mps=1.0),
    "people in a corridor": _among_people,
    "office floor": _drive(lambda: floor_plan(1), speed_mps=0.6, turn_rate_radps=1.2),
}
SICK = ("square of corridors", "office floor")
"""The courses that a SICK with 180 rays is driven on; the others are those of an URG-04LX."""


def simulated(name: str, seed: int = 0, laser: world.Laser | None = None) -> Course:
    """Drive one of COURSES, with its own laser or another."""
    laser = laser or (world.Sick() if name in SICK else world.Urg04lx())
    beams = beams_of_laser(laser)
    records = COURSES[name](seed, laser)
    scans = [Scan(stamp_ns, ranges_m, beams) for stamp_ns, ranges_m, _ in records]
    return Course(name, scans, truth=np.array([pose for *_, pose in records]))


def logged(name: str, most: int | None = None) -> Course | None:
    """Open exp1, exp2, intel, fr079, ccny_urg or wean1; None, said aloud, where its file is not there."""
    found = sorted(path for path in DATA.glob(f"{name}.*") if path.suffix != ".relations")
    if not found:
        print(f"left out: needs {name} in ../shared/data", file=sys.stderr)
        return None
    log = open_log(found[0])
    scans = [scan for scan, _ in zip(iterate(log), range(most or len(log)), strict=False)]
    truths = DATA / f"{name}.relations"
    return Course(
        name,
        scans,
        relations=read_relations(truths) if truths.exists() else None,
        wheels=wheels(found[0], len(scans), beams_of(log).period_s) if found[0].suffix == ".dat" else None,
        base_t_laser=BASE_T_LASER.get(name, np.zeros(3)),
    )


TICKS_PER_TURN, WHEEL_RADIUS_M, HALF_TRACK_M = 2000.0, 0.077, 0.165
"""Of the robot of exp1 and exp2; checked there: the way by wheels and by laser agree within 0.4 %."""
TICKS_LEAD_S = 0.15


def wheels(path: Path, count: int, period_s: float) -> np.ndarray:
    """Way of the robot by its wheel ticks, (count, 3), at the time of each scan; a measure, never an input.

    The ticks lead the scan of their line, so that each scan takes those of a moment before, interpolated.
    """
    ticks = np.loadtxt(path, usecols=(2, 3), max_rows=count)
    turns = np.diff(ticks, axis=0) / TICKS_PER_TURN * 2.0 * np.pi * WHEEL_RADIUS_M
    pose, way = np.zeros(3), [np.zeros(3)]
    for left, right in turns:
        ahead, turn = 0.5 * (left + right), 0.5 * (right - left) / HALF_TRACK_M
        pose = compose(pose, np.array((ahead * np.cos(turn / 2), ahead * np.sin(turn / 2), turn)))
        way.append(pose)
    way = np.array(way)
    way[:, 2] = np.unwrap(way[:, 2])
    at = np.arange(count) - TICKS_LEAD_S / period_s
    late = np.stack([np.interp(at, np.arange(count), column) for column in way.T], axis=-1)
    late[:, 2] = wrap(late[:, 2])
    return late


def over_scans(poses: np.ndarray, steps: int) -> np.ndarray:
    """Motion over `steps` scans from every pose (N, 3): (N - steps, 3)."""
    return between(poses[:-steps], poses[steps:])
