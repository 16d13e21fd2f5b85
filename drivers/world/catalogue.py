"""The buildings that go by a name, for whoever chooses one in a configuration."""

from collections.abc import Callable, Mapping
from typing import Literal, TypeAlias

from drivers.world.building import Building
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

BuildingName: TypeAlias = Literal[
    "demo",
    "room",
    "doorway",
    "corridor",
    "hallway_with_doors",
    "pillar_hall",
    "loop_corridor",
    "square_of_corridors",
]

BUILDINGS: Mapping[BuildingName, Callable[[], Building]] = {
    "demo": demo_building,
    "room": room,
    "doorway": doorway,
    "corridor": corridor,
    "hallway_with_doors": hallway_with_doors,
    "pillar_hall": pillar_hall,
    "loop_corridor": loop_corridor,
    "square_of_corridors": square_of_corridors,
}
