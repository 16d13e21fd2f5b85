"""Everything that decides a map made from a file, as people write it and as recordings carry it."""

from dataclasses import dataclass, field
from typing import Any

from processing.slam import SlamConfig
from runtime.config import build, parse_yaml
from runtime.nodes import mounting


@dataclass(frozen=True, slots=True, kw_only=True)
class OfflineConfig:
    """Everything that decides a map, apart from log and seed."""

    slam: SlamConfig = field(default_factory=SlamConfig)
    laser_in_base: mounting.LaserInBase | None = None
    """Mounting of the laser: x, y (m) and yaw (rad) in the base frame; the poses are then the base's."""

    def __post_init__(self) -> None:
        if not mounting.is_possible(self.laser_in_base):
            raise ValueError(f"laser_in_base = {self.laser_in_base}, must be three finite numbers")


def recorded_config(text: str, where: str) -> OfflineConfig:
    """Return the configuration under which a recorded run mapped, from the YAML in its recording or session.

    Raises:
        ConfigError: A parameter in it does not exist here; the text names it.
    """
    data = parse_yaml(text, where)
    if isinstance(data, dict) and "slam" in data:
        return build(OfflineConfig, data, where)
    nodes = data.get("nodes") if isinstance(data, dict) else None
    if not isinstance(nodes, dict):
        return OfflineConfig()
    parts: dict[str, Any] = {}
    for node, part in (("matcher", "odometry"), ("mapper", "mapping")):
        config = nodes.get(node)
        if isinstance(config, dict) and part in config:
            parts[part] = config[part]
    return OfflineConfig(slam=build(SlamConfig, parts, f"{where}: nodes"))
