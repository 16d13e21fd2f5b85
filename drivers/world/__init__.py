"""A simulated world for the emulators: buildings, a ray caster, laser models and a wheeled robot."""

from drivers.world.building import Building, box, outline
from drivers.world.catalogue import BUILDINGS, BuildingName
from drivers.world.drive import simulate_scans
from drivers.world.generators import (
    corridor,
    demo_building,
    doorway,
    hallway_with_doors,
    loop_corridor,
    pillar_hall,
    room,
    square_of_corridors,
)
from drivers.world.laser import Laser, Sick, Spinning, Urg04lx, bearings
from drivers.world.pursuit import Pursuit, PursuitConfig
from drivers.world.raycast import Hits, cast
from drivers.world.robot import WheeledRobot

__all__ = [
    "BUILDINGS",
    "Building",
    "BuildingName",
    "Hits",
    "Laser",
    "Pursuit",
    "PursuitConfig",
    "Sick",
    "Spinning",
    "Urg04lx",
    "WheeledRobot",
    "bearings",
    "box",
    "cast",
    "corridor",
    "demo_building",
    "doorway",
    "hallway_with_doors",
    "loop_corridor",
    "outline",
    "pillar_hall",
    "room",
    "simulate_scans",
    "square_of_corridors",
]
