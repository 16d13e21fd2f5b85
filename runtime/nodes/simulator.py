"""Simulator process: a building, a robot in it, and the two serial lines at which the real drivers listen.

It publishes `truth`, where the robot really is, for the scripted operator and for whoever judges a map; the
matcher and the mapper never see it. Killed and started again, the robot stands where it stood.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers import world
from drivers.create.emulator import CreateEmulator
from drivers.urg04lx.emulator import Emulator as LaserEmulator
from runtime import messages
from runtime.nodes.convert import pose_to_message
from runtime.port import Port
from runtime.process.checkpoint import Checkpoint

SUBSCRIBES: tuple[str, ...] = ()
PUBLISHES: tuple[str, ...] = ("truth",)

BUILDINGS: dict[str, Callable[[], world.Building]] = {
    "demo": world.demo_building,
    "room": world.room,
    "doorway": world.doorway,
    "corridor": world.corridor,
    "hallway_with_doors": world.hallway_with_doors,
    "pillar_hall": world.pillar_hall,
    "loop_corridor": world.loop_corridor,
    "square_of_corridors": world.square_of_corridors,
}
_TRUTH_NS = 100_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """What is simulated, and where the lines appear."""

    building: Literal[
        "demo",
        "room",
        "doorway",
        "corridor",
        "hallway_with_doors",
        "pillar_hall",
        "loop_corridor",
        "square_of_corridors",
    ] = "demo"
    laser: Path = Path("laser")
    """Link to the laser's line; relative to the run's directory."""
    base: Path = Path("base")
    """Link to the robot's line; relative to the run's directory."""
    model: Literal["create1", "create2"] = "create1"


def run(port: Port, config: Config) -> int:
    """Simulate until the port stops."""
    building = BUILDINGS[config.building]()
    place = port.run_dir / "simulator.checkpoint"
    # As if writing took no time: a few bytes, and a place that is seconds old would be another place.
    kept = Checkpoint(place, _TRUTH_NS, config, now_ns=lambda: 0)
    robot = world.WheeledRobot(building, kept.read(), now_ns=time.monotonic_ns())
    links = [port.run_dir / config.laser, port.run_dir / config.base]
    laser = LaserEmulator(sight(building, robot, port.seed), link=links[0], seed=port.seed)
    base = CreateEmulator(robot, model=config.model, link=links[1], seed=port.seed)
    try:
        with laser, base:
            port.ready()
            _publish_truth(port, robot, base, kept)
    finally:
        for file in (*links, place):
            file.unlink(missing_ok=True)
    return 0


def sight(
    building: world.Building, robot: world.WheeledRobot, seed: int
) -> Callable[[NDArray[np.int64]], NDArray[np.int32]]:
    """Return what a laser in the middle of the robot sees: times of its rays (ns) to mm or error codes."""
    laser, rng = world.Urg04lx(), np.random.default_rng(seed)

    def scene(ray_times_ns: NDArray[np.int64]) -> NDArray[np.int32]:
        return laser.measure_mm(building, robot.poses_at(ray_times_ns), rng)

    return scene


def _publish_truth(port: Port, robot: world.WheeledRobot, base: CreateEmulator, kept: Checkpoint) -> None:
    due_ns = time.monotonic_ns()
    while not port.stopping:
        now_ns = time.monotonic_ns()
        if now_ns < due_ns:
            time.sleep((due_ns - now_ns) / 1e9)
            continue
        due_ns = max(due_ns + _TRUTH_NS, now_ns)
        map_t_base = robot.poses_at(now_ns)[0]
        stamp = messages.header(port.clock.from_monotonic_ns(now_ns), "map")
        if kept.due(now_ns):
            kept.write(now_ns, map_t_base)
        port.publish("truth", messages.PoseStamped(header=stamp, pose=pose_to_message(map_t_base)))
        x, y, yaw = map_t_base
        where = f"{x:.2f} {y:.2f} m, {np.degrees(yaw) % 360.0:.0f} deg"
        port.report("ok", f"robot at {where}", mode=base.mode.name, bumps=robot.bumps)
