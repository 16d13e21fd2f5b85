"""Geometry of simulated lasers, as their messages carry it."""

from drivers.world import Laser
from processing.scan import Beams


def beams_of_laser(laser: Laser) -> Beams:
    """Return the beams of a simulated laser."""
    return Beams(
        count=laser.beams,
        angle_min_rad=laser.angle_min_rad,
        angle_increment_rad=laser.angle_increment_rad,
        time_increment_s=laser.time_increment_s,
        period_s=laser.period_s,
        range_min_m=laser.range_min_m,
        range_max_m=laser.range_max_m,
    )
