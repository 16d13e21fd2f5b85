"""Messages as ROS 2 sees them: CDR payloads, keys and tokens of rmw_zenoh, 33-byte attachments.

As rmw_zenoh of ROS 2 jazzy and later has them.

Standard message types only, so that recordings and live topics are readable by everyone. The classes are
the dataclasses of `rosbags`; every field must be given, and arrays must have the message's own dtype. A
payload from the wire may be anything: `decode` raises `BadMessageError` and nothing else, and its callers
count it.
"""

import struct
from dataclasses import dataclass
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.stores import ros2_jazzy

from runtime.errors import HallwayError

Time = ros2_jazzy.builtin_interfaces__msg__Time
DiagnosticArray = ros2_jazzy.diagnostic_msgs__msg__DiagnosticArray
DiagnosticStatus = ros2_jazzy.diagnostic_msgs__msg__DiagnosticStatus
KeyValue = ros2_jazzy.diagnostic_msgs__msg__KeyValue
Point = ros2_jazzy.geometry_msgs__msg__Point
Pose = ros2_jazzy.geometry_msgs__msg__Pose
PoseArray = ros2_jazzy.geometry_msgs__msg__PoseArray
PoseStamped = ros2_jazzy.geometry_msgs__msg__PoseStamped
PoseWithCovariance = ros2_jazzy.geometry_msgs__msg__PoseWithCovariance
PoseWithCovarianceStamped = ros2_jazzy.geometry_msgs__msg__PoseWithCovarianceStamped
Quaternion = ros2_jazzy.geometry_msgs__msg__Quaternion
Transform = ros2_jazzy.geometry_msgs__msg__Transform
TransformStamped = ros2_jazzy.geometry_msgs__msg__TransformStamped
Twist = ros2_jazzy.geometry_msgs__msg__Twist
TwistStamped = ros2_jazzy.geometry_msgs__msg__TwistStamped
TwistWithCovariance = ros2_jazzy.geometry_msgs__msg__TwistWithCovariance
Vector3 = ros2_jazzy.geometry_msgs__msg__Vector3
MapMetaData = ros2_jazzy.nav_msgs__msg__MapMetaData
OccupancyGrid = ros2_jazzy.nav_msgs__msg__OccupancyGrid
Odometry = ros2_jazzy.nav_msgs__msg__Odometry
Path = ros2_jazzy.nav_msgs__msg__Path
Clock = ros2_jazzy.rosgraph_msgs__msg__Clock
BatteryState = ros2_jazzy.sensor_msgs__msg__BatteryState
LaserScan = ros2_jazzy.sensor_msgs__msg__LaserScan
PointCloud2 = ros2_jazzy.sensor_msgs__msg__PointCloud2
PointField = ros2_jazzy.sensor_msgs__msg__PointField
Header = ros2_jazzy.std_msgs__msg__Header
UInt8 = ros2_jazzy.std_msgs__msg__UInt8
TFMessage = ros2_jazzy.tf2_msgs__msg__TFMessage

TYPES = get_typestore(Stores.ROS2_JAZZY)
# A standard package that the type store happens not to carry.
TYPES.register(
    get_types_from_msg(
        "std_msgs/Header header\nint32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data\n",
        "map_msgs/msg/OccupancyGridUpdate",
    )
)
OccupancyGridUpdate: Any = TYPES.types["map_msgs/msg/OccupancyGridUpdate"]


class BadMessageError(HallwayError):
    """A payload that is not the message it should be."""


def prepare(msgtype: str) -> None:
    """Make what reads and writes a type now; the first message of it would wait for that, up to 80 ms."""
    TYPES.get_msgdef(msgtype)


def encode(message: Any) -> bytes:
    """Serialise a message to CDR, little endian, with its four-byte header."""
    return bytes(TYPES.serialize_cdr(message, message.__msgtype__))


def decode(payload: bytes, msgtype: str) -> Any:
    """Read a message of `msgtype`; its arrays are read-only views into `payload`.

    Raises:
        BadMessageError: The payload is cut, foreign, or holds impossible lengths.
    """
    if len(payload) < 4 or payload[0] != 0 or payload[1] not in (0, 1):
        raise BadMessageError(f"{msgtype}: {len(payload)} bytes without a CDR header")
    try:
        return TYPES.deserialize_cdr(payload, msgtype)
    except Exception as error:  # generated code raises whatever the bytes provoke
        raise BadMessageError(f"{msgtype}: {len(payload)} bytes, {type(error).__name__}: {error}") from error


def time_of(stamp_ns: int) -> Time:
    """Return the ROS time of a stamp."""
    return Time(sec=stamp_ns // 1_000_000_000, nanosec=stamp_ns % 1_000_000_000)


def stamp_ns_of(time: Time) -> int:
    """Return the stamp of a ROS time."""
    return time.sec * 1_000_000_000 + time.nanosec


def header(stamp_ns: int, frame: str) -> Header:
    """Return the header of a message about `stamp_ns` whose values are seen from `frame`."""
    return Header(stamp=time_of(stamp_ns), frame_id=frame)


def peek_stamp_ns(payload: bytes) -> int | None:
    """Read the header stamp of any message that begins with a header; None if it is too short."""
    if len(payload) < 12:
        return None
    sec, nanosec = struct.unpack_from("<iI" if payload[1] == 1 else ">iI", payload, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)


# ---- attachments: who sent it, as which number, when ----

_ATTACHMENT = struct.Struct("<qqB16s")


@dataclass(frozen=True, slots=True)
class Attachment:
    """What rmw_zenoh puts beside each payload; 33 bytes."""

    sequence: int
    """Of this publisher, from 1, without gaps."""
    published_ns: int
    gid: bytes
    """16 bytes that name the publisher; a publisher that was started again has another."""

    def encode(self) -> bytes:
        """Return the 33 bytes."""
        return _ATTACHMENT.pack(self.sequence, self.published_ns, 16, self.gid)

    @classmethod
    def decode(cls, data: bytes | None) -> "Attachment | None":
        """Read an attachment; None where there is none, or another kind (rmw_zenoh before 0.2.4)."""
        if data is None or len(data) != _ATTACHMENT.size or data[16] != 16:
            return None
        sequence, published_ns, _, gid = _ATTACHMENT.unpack(data)
        return cls(sequence, published_ns, gid)


# ---- keys and tokens ----


def dds_name(msgtype: str) -> str:
    """Return the type's DDS name: `sensor_msgs::msg::dds_::LaserScan_`."""
    package, _, name = msgtype.split("/")
    return f"{package}::msg::dds_::{name}_"


def type_hash(msgtype: str) -> str:
    """Return `RIHS01_<hash>`, by which ROS 2 knows that both sides mean the same type."""
    return str(TYPES.hash_rihs01(msgtype))


def topic_key(topic: str, msgtype: str, domain: int = 0) -> str:
    """Return the key expression of a full topic name such as `robot/scan`."""
    return Endpoint("MP", "", topic.strip("/"), msgtype, type_hash(msgtype)).key(domain)


def qos_text(*, latched: bool, depth: int) -> str:
    """Return the quality of service as a token carries it; reliable, keep last `depth`."""
    return f":{1 if latched else ''}:,{depth}:,:,:,,"


def _mangled(name: str) -> str:
    """Return an absolute ROS name as a token carries it: `/robot/scan` as `%robot%scan`."""
    return "%" + name.strip("/").replace("/", "%")


def node_token(zid: str, robot: str, node: str, domain: int = 0) -> str:
    """Return the liveliness token that makes a process a ROS node in its robot's namespace."""
    return f"@ros2_lv/{domain}/{zid}/0/0/NN/%/{_mangled(robot)}/{node}"


def endpoint_token(
    zid: str,
    entity: int,
    kind: str,
    robot: str,
    node: str,
    topic: str,
    msgtype: str,
    qos: str,
    domain: int = 0,
) -> str:
    """Return the token of one publisher (kind `MP`) or subscription (`MS`) of a full topic name."""
    return (
        f"@ros2_lv/{domain}/{zid}/0/{entity}/{kind}/%/{_mangled(robot)}/{node}/{_mangled(topic)}"
        f"/{dds_name(msgtype)}/{type_hash(msgtype)}/{qos}"
    )


def node_token_pattern(robot: str, domain: int = 0) -> str:
    """Return the key expression of the node tokens of one robot."""
    return f"@ros2_lv/{domain}/*/*/*/NN/*/{_mangled(robot)}/*"


def node_of_token(token: str) -> str | None:
    """Return the node name of a node token; None for other tokens."""
    parts = token.split("/")
    return parts[8] if len(parts) == 9 and parts[5] == "NN" else None


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One publisher or subscription, as its token tells."""

    kind: str
    """`MP` or `MS`."""
    node: str
    topic: str
    """Full name, without the leading slash."""
    type: str
    hash: str
    """`RIHS01_<hash>`, as whoever declared it knows the type."""
    latched: bool = False

    def key(self, domain: int = 0) -> str:
        """Return the key expression of its messages."""
        return f"{domain}/{self.topic}/{dds_name(self.type)}/{self.hash}"


def endpoints_of(tokens: list[str]) -> list[Endpoint]:
    """Return the publishers and subscriptions among liveliness tokens, whoever declared them."""
    found: list[Endpoint] = []
    for token in tokens:
        parts = token.split("/")
        # ROS 2 lyrical may say more behind the quality of service.
        if len(parts) >= 13 and parts[5] in ("MP", "MS"):
            package, _, dds = parts[10].partition("::msg::dds_::")
            msgtype = f"{package}/msg/{dds.removesuffix('_')}"
            topic = parts[9].removeprefix("%").replace("%", "/")
            latched = parts[12].split(":")[1:2] == ["1"]
            found.append(Endpoint(parts[5], parts[8], topic, msgtype, parts[11], latched))
    return found


def has_header(msgtype: str) -> bool:
    """Whether messages of a known type begin with a header, and so with a stamp."""
    fields = TYPES.fielddefs[msgtype][1]
    return bool(fields) and bool(fields[0][1][1] == "std_msgs/msg/Header")


def is_known(msgtype: str, hashed: str) -> bool:
    """Whether a type is known here, and by the same definition."""
    return msgtype in TYPES.fielddefs and type_hash(msgtype) == hashed
