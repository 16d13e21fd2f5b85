"""Where the laser sits on the robot, and the frames that follow: map, odom, base_link, laser (REP-105).

Where that is not known, `odom` leads to `laser` itself, and there is no `base_link`.
"""

import math

import numpy as np

from processing import se2
from runtime import messages
from runtime.nodes.convert import transform_to_message

LaserInBase = tuple[float, float, float]
"""x, y (m) and yaw (rad) of the laser in the robot's frame."""


def is_possible(laser_in_base: LaserInBase | None) -> bool:
    """Whether it is unknown, or finite."""
    return laser_in_base is None or all(map(math.isfinite, laser_in_base))


def of_base(parent_t_laser: se2.Pose, laser_in_base: LaserInBase) -> se2.Pose:
    """Return the pose, or poses (N, 3), of the robot whose laser is there."""
    return se2.compose(parent_t_laser, se2.invert(np.array(laser_in_base)))


def tf(stamp_ns: int, odom_t_laser: se2.Pose, laser_in_base: LaserInBase | None) -> messages.TFMessage:
    """Return where the robot, or the laser alone, is in `odom`."""
    if laser_in_base is None:
        placed = transform_to_message(stamp_ns, "odom", "laser", odom_t_laser)
    else:
        placed = transform_to_message(stamp_ns, "odom", "base_link", of_base(odom_t_laser, laser_in_base))
    return messages.TFMessage(transforms=[placed])


def tf_static(stamp_ns: int, laser_in_base: LaserInBase) -> messages.TFMessage:
    """Return where the laser is on the robot, for good."""
    mounted = transform_to_message(stamp_ns, "base_link", "laser", np.array(laser_in_base))
    return messages.TFMessage(transforms=[mounted])
