"""What a robot says while it drives a straight line through a walled room: messages, in order."""

import numpy as np

from processing.motion import Motion
from processing.scan import Beams, Scan
from runtime import messages
from runtime.nodes import convert
from runtime.port import Received

BEGIN_NS = 1_790_000_000_000_000_000
PERIOD_NS = 100_000_000
BEAMS = Beams(count=180, angle_min_rad=-1.57, angle_increment_rad=0.0175)
CELL_M = 0.05


def stamp(number):
    return BEGIN_NS + number * PERIOD_NS


def received(topic, message, published_ns):
    return Received(topic, message, 1, published_ns, published_ns)


def laser(number):
    return np.array((0.1 * number, 0.0, 0.0))


def scan(number, range_m=2.0):
    ranges = np.full(BEAMS.count, range_m, dtype=np.float32)
    return convert.scan_to_message(Scan(stamp(number), ranges, BEAMS))


def odom(number, variances=(1e-4, 1e-6, 1e-6)):
    return convert.motion_to_message(Motion(stamp(number), laser(number), np.diag(variances), np.zeros(3)))


def cloud(number, points=((2.0, 0.0), (0.0, 2.0))):
    fields = [messages.PointField(name=n, offset=4 * i, datatype=7, count=1) for i, n in enumerate("xyz")]
    data = np.zeros((len(points), 3), dtype=np.float32)
    data[:, :2] = points
    return messages.PointCloud2(
        header=messages.header(stamp(number), "laser"),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=12,
        row_step=12 * len(points),
        data=np.frombuffer(data.tobytes(), dtype=np.uint8),
        is_dense=True,
    )


def pose(number, variances=(0.01, 0.0025)):
    covariance = np.zeros((6, 6))
    covariance[0, 0], covariance[1, 1] = variances
    return messages.PoseWithCovarianceStamped(
        header=messages.header(stamp(number), "map"),
        pose=messages.PoseWithCovariance(
            pose=convert.pose_to_message(laser(number)), covariance=covariance.ravel()
        ),
    )


def particles(number):
    poses = [convert.pose_to_message(laser(number) + np.array((0.0, dy, 0.0))) for dy in (-0.2, 0.0, 0.2)]
    return messages.PoseArray(header=messages.header(stamp(number), "map"), poses=poses)


def path(number):
    poses = [
        messages.PoseStamped(header=messages.header(stamp(k), "map"), pose=convert.pose_to_message(laser(k)))
        for k in range(number + 1)
    ]
    return messages.Path(header=messages.header(stamp(number), "map"), poses=poses)


def room(rows=80, cols=160):
    """Free ground in walls, 8 m by 4 m, unknown around it."""
    cells = np.full((rows + 40, cols + 40), -1, dtype=np.int8)
    cells[20:-20, 20:-20] = 100
    cells[22:-22, 22:-22] = 0
    return cells


def grid(number, cells=None, origin=(-2.0, -3.0)):
    cells = room() if cells is None else cells
    info = messages.MapMetaData(
        map_load_time=messages.time_of(0),
        resolution=CELL_M,
        width=cells.shape[1],
        height=cells.shape[0],
        origin=convert.pose_to_message(np.array((*origin, 0.0))),
    )
    return messages.OccupancyGrid(header=messages.header(stamp(number), "map"), info=info, data=cells.ravel())


def diagnostics(number, node, level=0, text="running", **values):
    entries = [messages.KeyValue(key=k.replace("__", "."), value=str(v)) for k, v in values.items()]
    status = messages.DiagnosticStatus(
        level=level, name=f"robot/{node}", message=text, hardware_id="", values=entries
    )
    return messages.DiagnosticArray(header=messages.header(stamp(number), ""), status=[status])


def bumper(bits):
    return messages.UInt8(data=bits)


def battery(share):
    zeros = dict.fromkeys(("voltage", "temperature", "current", "charge", "capacity", "design_capacity"), 0.0)
    codes = dict.fromkeys(("power_supply_status", "power_supply_health", "power_supply_technology"), 0)
    none = np.zeros(0, dtype=np.float32)
    return messages.BatteryState(
        header=messages.header(BEGIN_NS, ""),
        **zeros,
        **codes,
        percentage=share,
        present=True,
        cell_voltage=none,
        cell_temperature=none,
        location="",
        serial_number="",
    )


def drive(scans=40):
    """Everything of a drive, as it would arrive."""
    for k in range(scans):
        at_ns = stamp(k) + 110_000_000
        yield received("scan", scan(k), at_ns)
        yield received("match_points", cloud(k), at_ns + 1)
        yield received("odom", odom(k), at_ns + 2)
        yield received("pose", pose(k), at_ns + 3)
        if k % 10 == 0:
            yield received("particles", particles(k), at_ns + 4)
            yield received("map", grid(k), at_ns + 5)
            yield received("trajectory", path(k), at_ns + 6)
            yield received("diagnostics", diagnostics(k, "matcher", state="TRACKING"), at_ns + 7)
            yield received("battery", battery(0.8), at_ns + 8)
