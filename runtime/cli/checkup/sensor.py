"""The laser itself: who it is, how often and how well it measures, and how its clock runs."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from drivers.errors import DeviceError, PortBusyError, PortForbiddenError, PortMissingError
from drivers.transport import SerialStream
from drivers.urg04lx import connect
from drivers.urg04lx.decoder import Decoder
from drivers.urg04lx.device import Urg
from drivers.urg04lx.events import Connected, Notice, UrgScan
from drivers.urg04lx.geometry import reply_bytes
from drivers.urg04lx.link import Link
from drivers.urg04lx.settings import UrgConfig
from drivers.urg04lx.timecheck import Bounds, clock_bounds
from runtime.cli.checkup.finding import Finding, Verdict

_CONNECT_S = 12.0
_LATENCY_MARGIN_MS = 15.0


@dataclass
class Sample:
    """What the sensor gave while it was watched."""

    connected: Connected | None = None
    scans: list[UrgScan] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    damaged: int = 0
    missed: int = 0
    drift: float = 0.0
    jumps: int = 0
    bounds: Bounds | None = None
    error: DeviceError | None = None


def watch(config: UrgConfig, seconds: float, now_ns: Callable[[], int] = time.monotonic_ns) -> Sample:
    """Run the real driver for a while, and ask the sensor's clock afterwards."""
    sample = Sample()
    device = Urg(config, now_ns=now_ns, patience_s=1.0)
    events = device.events()
    end_ns = now_ns() + round(_CONNECT_S * 1e9)
    try:
        for event in events:
            if isinstance(event, Connected):
                sample.connected = event
            elif isinstance(event, Notice):
                sample.notices.append(event)
            elif isinstance(event, UrgScan):
                if not sample.scans:
                    end_ns = now_ns() + round(seconds * 1e9)
                sample.scans.append(event)
            if now_ns() > end_ns:
                break
    except DeviceError as error:
        sample.error = error
    finally:
        events.close()
    sample.damaged, sample.missed = device.decoder.damaged.total(), device.sequence.missed
    sample.drift, sample.jumps = device.clock.drift, device.clock.jumps
    if sample.connected and sample.scans:
        sample.bounds = _ask_clock(sample.connected, now_ns)
    return sample


def findings(sample: Sample, config: UrgConfig) -> list[Finding]:
    """Judge what was seen."""
    if sample.connected is None or not sample.scans:
        return [_no_scans(sample)]
    return [
        _unit(sample.connected),
        _rate(sample),
        _beams(sample),
        _valid(sample),
        _noise(sample),
        _clock(sample),
        _latency(sample, config),
        _line(sample),
    ]


def _ask_clock(connected: Connected, now_ns: Callable[[], int]) -> Bounds | None:
    try:
        with SerialStream(connected.path, connected.baud or connect.USB_BAUD) as stream:
            link = Link(stream, Decoder(), now_ns)
            asking = clock_bounds(link)
            while True:
                try:
                    next(asking)
                except StopIteration as end:
                    result: Bounds | None = end.value
                    return result
    except DeviceError:
        return None  # the scans are what counts; the check of the clock is an extra


def _no_scans(sample: Sample) -> Finding:
    error = sample.error
    text = str(error) if error else next((n.text for n in reversed(sample.notices)), "no answer")
    found, _, advice = text.partition(";")
    closed = isinstance(error, PortMissingError | PortForbiddenError | PortBusyError)
    advice = advice.strip() or (
        "see above" if closed else "unplug the sensor, wait ten seconds, plug it in again"
    )
    return Finding(what="sensor", found=found, needed="scans", verdict=Verdict.FAIL, advice=advice)


def _unit(connected: Connected) -> Finding:
    version = connected.identity.version
    found = f"{version.product or connected.identity.parameters.model}, {version.serial}, {version.firmware}"
    odd = "; ".join((*version.warnings, *connected.identity.parameters.warnings))
    return Finding(
        what="sensor",
        found=found,
        needed="URG-04LX or URG-04LX-UG01",
        verdict=Verdict.WARN if odd else Verdict.OK,
        advice=odd,
    )


def _rate(sample: Sample) -> Finding:
    assert sample.connected
    stamps = np.array([scan.stamp_ns for scan in sample.scans])
    wanted_hz = 1.0 / sample.connected.sweep.period_s
    rate_hz = (len(stamps) - 1) / max(1e-3, float(np.ptp(stamps)) / 1e9) if len(stamps) > 1 else 0.0
    good = rate_hz > 0.97 * wanted_hz
    return Finding(
        what="scan rate",
        found=f"{rate_hz:.2f} Hz",
        needed=f"{wanted_hz:g} Hz",
        verdict=Verdict.OK if good else Verdict.FAIL,
        advice="" if good else "another cable; no hub; on RS-232 a higher rate",
    )


def _beams(sample: Sample) -> Finding:
    assert sample.connected
    sweep = sample.connected.sweep
    last_rad = sweep.angle_min_rad + (sweep.count - 1) * sweep.angle_increment_rad
    first, last = np.degrees((sweep.angle_min_rad, last_rad))
    counts = {len(scan.ranges_m) for scan in sample.scans}
    same = counts == {sweep.count}
    return Finding(
        what="beams",
        found=f"{', '.join(map(str, sorted(counts)))} from {first:.1f} to {last:.1f} deg",
        needed=f"{sweep.count} in every scan",
        verdict=Verdict.OK if same else Verdict.FAIL,
        advice="" if same else "report this: the sensor changed its mind",
    )


def _valid(sample: Sample) -> Finding:
    share = float(np.mean([np.isfinite(scan.ranges_m).mean() for scan in sample.scans]))
    verdict = Verdict.OK if share >= 0.2 else Verdict.WARN if share >= 0.05 else Verdict.FAIL
    advice = (
        "is the window clean and uncovered, are there walls within 4 m? Black or slanted ones return little"
    )
    return Finding(
        what="valid beams",
        found=f"{share:.0%}",
        needed="20 % or more",
        verdict=verdict,
        advice="" if verdict is Verdict.OK else advice,
    )


def _noise(sample: Sample) -> Finding:
    assert sample.connected
    limit_mm = 30 if sample.connected.identity.version.ug01 else 10
    ranges_mm = np.array([scan.ranges_m for scan in sample.scans]) * 1000.0
    steady = np.isfinite(ranges_mm).all(axis=0)
    if len(ranges_mm) < 10 or not steady.any():
        return Finding(
            what="noise",
            found="no beam that is valid in every scan",
            needed=f"{limit_mm} mm or less on a still wall",
            verdict=Verdict.WARN,
            advice="point the sensor at a bright wall at 1 m, and let nothing move",
        )
    sigma_mm = float(np.median(ranges_mm[:, steady].std(axis=0)))
    good = sigma_mm <= limit_mm
    return Finding(
        what="noise",
        found=f"{sigma_mm:.1f} mm (median of {np.count_nonzero(steady)} beams)",
        needed=f"{limit_mm} mm or less on a still wall",
        verdict=Verdict.OK if good else Verdict.WARN,
        advice="" if good else "did something move? Otherwise: let it warm up, keep sunlight away",
    )


def _clock(sample: Sample) -> Finding:
    delays_ms = _delays_ms(sample)
    jitter_ms = float(np.percentile(delays_ms - delays_ms.min(), 99))
    good = jitter_ms < 20.0 and sample.jumps == 0
    return Finding(
        what="clock",
        found=f"jitter {jitter_ms:.1f} ms (p99), drift {sample.drift:+.3%}, {sample.jumps} jumps",
        needed="jitter under 20 ms, no jumps",
        verdict=Verdict.OK if good else Verdict.WARN,
        advice="" if good else "end what burdens this machine; give the laser process a priority",
    )


def _latency(sample: Sample, config: UrgConfig) -> Finding:
    """Compare the delay of scans with the offset of the clocks as the sensor itself tells it."""
    assumed_ms = config.clock.latency_ms
    needed = f"{assumed_ms:g} ms, as the stamps assume"
    bounds = sample.bounds
    if bounds is None:
        return Finding(
            what="clock offset",
            found="the sensor does not tell its time (TM)",
            needed=needed,
            verdict=Verdict.WARN,
            advice="the stamps are as good as the assumed latency",
        )
    least_ms = float(_delays_ms(sample).min())
    low_ms, high_ms = least_ms - bounds.high_ms, least_ms - bounds.low_ms
    good = low_ms - _LATENCY_MARGIN_MS <= assumed_ms <= high_ms + _LATENCY_MARGIN_MS
    return Finding(
        what="clock offset",
        found=f"{bounds.low_ms / 1e3:.3f} s; scans come {low_ms:.0f} .. {high_ms:.0f} ms after step 0",
        needed=needed,
        verdict=Verdict.OK if good else Verdict.WARN,
        advice="" if good else f"set latency_ms: {(low_ms + high_ms) / 2:.0f} in the laser's configuration",
    )


def _line(sample: Sample) -> Finding:
    assert sample.connected
    request, baud = sample.connected.request, sample.connected.baud
    per_s = reply_bytes(request) / sample.connected.sweep.period_s
    room = f"{baud / 10e3:.1f} kB/s" if baud else "USB"
    total = len(sample.scans) + sample.damaged + sample.missed
    lost = sample.damaged + sample.missed
    lost_text = f"{sample.damaged} damaged and {sample.missed} missed of {total} scans"
    verdict = Verdict.OK if lost == 0 else Verdict.WARN if lost < 0.05 * total else Verdict.FAIL
    return Finding(
        what="bandwidth",
        found=f"{per_s / 1e3:.1f} kB/s of {room}, {lost_text}",
        needed="none lost",
        verdict=verdict,
        advice="" if lost == 0 else "a shorter or shielded cable, no hub, a lower rate on RS-232",
    )


def _delays_ms(sample: Sample) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    """From each scan's own stamp to its first byte, with the drift of the clocks taken out; (N,) ms."""
    sensor_ms = np.unwrap([float(scan.sensor_ms) for scan in sample.scans], period=float(1 << 24))
    arrival_ms = np.array([scan.arrival_ns for scan in sample.scans]) / 1e6
    return np.asarray(arrival_ms - sensor_ms - sample.drift * (sensor_ms - sensor_ms[-1]))
