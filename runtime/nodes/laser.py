"""Laser process: the scans of a URG-04LX, each under the time its first ray was taken.

The line is read by a thread of its own, so that a slow bus cannot make scans old; an error code of the sensor
is NaN, "no information", and never a distance.  A range beyond the guaranteed 4095 mm is kept, and counted.
"""

import os
from collections import Counter, deque
from dataclasses import dataclass

import numpy as np

from drivers.urg04lx.clockmap import ClockConfig
from drivers.urg04lx.device import Urg
from drivers.urg04lx.events import Connected, Notice, UrgScan
from drivers.urg04lx.geometry import Sweep
from drivers.urg04lx.reader import UrgReader
from drivers.urg04lx.settings import UrgConfig
from processing.scan import Beams, Scan
from runtime.errors import ConfigError
from runtime.nodes.convert import scan_to_message
from runtime.port import Level, Port

SUBSCRIBES: tuple[str, ...] = ()
PUBLISHES: tuple[str, ...] = ("scan",)

_READ_S = 0.05
_REPORT_NS = 1_000_000_000
_BLIND_SHARE = 0.05
_BLIND_NS = 5_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The sensor, its line, and which part of its view is wanted."""

    path: str = "auto"
    """The port's node; relative paths are looked for in the run's directory; "auto": the first URG on USB."""
    serial: str = ""
    """Serial number of the unit wanted, where there are several."""
    baud: int = 0
    """Rate on RS-232; 0 = the sensor is on USB."""
    first_step: int | None = None
    """First ray of each scan, 0 .. 768; None = as far to the right as the sensor can measure. Step 384 is
    straight ahead, steps count to the left."""
    last_step: int | None = None
    """Last ray, 0 .. 768; None = as far to the left as it can."""
    cluster: int = 1
    """Steps that share one value, 1 .. 99."""
    skip: int = 0
    """Scans left out between two, 0 .. 9."""
    wide: bool = True
    """Three characters a value; two save a third of the line and end at 4095 mm."""
    sensitive: bool = False
    """20 % more sensitive, with wrong readings possible from strong reflectors."""
    upside_down: bool = False
    """The sensor hangs with its lid down."""
    latency_ms: float = 99.0
    """From the start of a revolution to the first byte of its scan, 0 .. 1000."""
    patience_s: float = 3.0
    """How long the port may be missing at the start."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.patience_s <= 600.0:
            raise ValueError(f"patience_s = {self.patience_s}, must be in [0, 600]")
        self.device(self.path)

    def device(self, path: str) -> UrgConfig:
        """Return the driver's part, checked."""
        return UrgConfig(
            port=path,
            serial=self.serial,
            baud=self.baud,
            first_step=self.first_step,
            last_step=self.last_step,
            cluster=self.cluster,
            skip=self.skip,
            wide=self.wide,
            sensitive=self.sensitive,
            clock=ClockConfig(latency_ms=self.latency_ms),
        )


def run(port: Port, config: Config) -> int:
    """Publish scans until the port stops; the sensor's laser is off afterwards."""
    path = config.path if config.path == "auto" else os.path.join(port.run_dir, config.path)
    device = Urg(config.device(path), now_ns=port.clock.now_ns, patience_s=config.patience_s)
    with UrgReader(device) as reader:
        laser = _Laser(port, config, reader)
        while not port.stopping:
            try:
                event = reader.read(_READ_S)
            except ValueError as error:
                raise ConfigError(f"laser: {error}") from error
            if isinstance(event, UrgScan):
                laser.publish(event)
            elif isinstance(event, Connected):
                laser.connect(event)
            elif isinstance(event, Notice):
                laser.hear(event)
            laser.tell()
    laser.count()
    return 0


def beams_of(sweep: Sweep, *, upside_down: bool) -> Beams:
    """Return the rays as the rest of the system knows them; hanging upside down they run clockwise."""
    sign = -1.0 if upside_down else 1.0
    return Beams(
        count=sweep.count,
        angle_min_rad=sign * sweep.angle_min_rad,
        angle_increment_rad=sign * sweep.angle_increment_rad,
        time_increment_s=sweep.time_increment_s,
        period_s=sweep.period_s,
        range_min_m=sweep.range_min_m,
        range_max_m=sweep.range_max_m,
    )


class _Laser:
    """What is between the driver's events and the port."""

    def __init__(self, port: Port, config: Config, reader: UrgReader) -> None:
        self._port, self._config, self._reader = port, config, reader
        self._beams: Beams | None = None
        self._told: Counter[str] = Counter()
        self._state: tuple[Level, str] = ("ok", "looking for the sensor")
        port.log.info("looking for the sensor")
        self._unit = ""
        self._reported_ns = 0
        self._stamps: deque[int] = deque(maxlen=50)
        self._valid_share = 1.0
        self._seeing_ns = 0

    def connect(self, event: Connected) -> None:
        self._beams = beams_of(event.sweep, upside_down=self._config.upside_down)
        version = event.identity.version
        self._unit = f"{version.product} {version.serial} {version.firmware}".strip()
        self._port.log.info("%s: %s, %d rays", event.path, self._unit, event.sweep.count)
        self._seeing_ns = self._port.clock.now_ns()
        self._port.ready()

    def hear(self, notice: Notice) -> None:
        level: Level = "error" if notice.level == "error" else "warn" if notice.level == "warn" else "ok"
        if (level, notice.text) != self._state and level == self._state[0] != "ok":
            self._port.log.warning("%s", notice.text)  # the frame logs changes of level only
        self._state = level, notice.text
        self._reported_ns = 0

    def publish(self, scan: UrgScan) -> None:
        assert self._beams is not None
        self._port.publish("scan", scan_to_message(Scan(scan.stamp_ns, scan.ranges_m, self._beams)))
        self._stamps.append(scan.stamp_ns)
        self._valid_share = scan.valid / self._beams.count
        if self._valid_share >= _BLIND_SHARE:
            self._seeing_ns = scan.arrival_ns

    def tell(self) -> None:
        """Report at 1 Hz, and at once after news."""
        now_ns = self._port.clock.now_ns()
        if now_ns - self._reported_ns < _REPORT_NS:
            return
        self._reported_ns = now_ns
        self.count()
        level, text = self._state
        if level == "ok" and self._beams and now_ns - self._seeing_ns > _BLIND_NS:
            level, text = "warn", "nearly all rays return nothing; is the window covered?"
        self._port.report(
            level, text, unit=self._unit, rate_hz=self._rate(), valid_percent=round(100 * self._valid_share)
        )

    def count(self) -> None:
        """Publish what was counted since the last time."""
        device = self._reader.device
        now = Counter(device.counts)  # copies: the reader goes on counting
        now.update(
            {f"damaged_{kind.replace(' ', '_')}": n for kind, n in dict(device.decoder.damaged).items()}
        )
        now["skipped_bytes"] = device.decoder.skipped_bytes
        now["foreign_replies"] = device.decoder.foreign
        now["missed_scans"] = device.sequence.missed
        now["duplicate_scans"] = device.sequence.duplicates
        now["clock_jumps"] = device.clock.jumps
        now["wrong_stamps"] = device.clock.outliers
        now["overwritten_scans"] = self._reader.overwritten
        for name, total in now.items():
            if total > self._told[name]:
                self._port.count(name, total - self._told[name])
        self._told = now

    def _rate(self) -> float:
        if len(self._stamps) < 2:
            return 0.0
        return round(float((len(self._stamps) - 1) / np.ptp(np.array(self._stamps)) * 1e9), 2)
