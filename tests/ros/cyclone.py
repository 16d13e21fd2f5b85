"""Messages whose packages have no wheel of ROS 2, as Cyclone DDS lays them out."""

from dataclasses import dataclass

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int8, int32, sequence, uint32


@dataclass
class Time(IdlStruct):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct):
    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Transform(IdlStruct):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct):
    transforms: sequence[TransformStamped]


@dataclass
class OccupancyGridUpdate(IdlStruct):
    header: Header
    x: int32
    y: int32
    width: uint32
    height: uint32
    data: sequence[int8]


LAYOUTS = {"tf2_msgs/msg/TFMessage": TFMessage, "map_msgs/msg/OccupancyGridUpdate": OccupancyGridUpdate}
