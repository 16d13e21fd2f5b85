"""The machine: cores, their governor, room on the disk, and the bus between processes."""

import os
import shutil
import tempfile
import time
from pathlib import Path

from runtime.cli.checkup.finding import Finding, Verdict

_ROUND_TRIPS = 100
_DISK_GB = 1.0


def cores() -> Finding:
    """Count the cores this process may use."""
    usable = len(os.sched_getaffinity(0))
    load = os.getloadavg()[0]
    busy = load > usable
    few = usable < 2
    advice = "two cores: one for the matcher, one for all the rest" if few else ""
    return Finding(
        what="cores",
        found=f"{usable}, load {load:.1f}",
        needed="2, not busy",
        verdict=Verdict.WARN if few or busy else Verdict.OK,
        advice=advice or ("end what burdens this machine" if busy else ""),
    )


def governor(sysfs: Path = Path("/sys/devices/system/cpu")) -> Finding:
    """Look how the kernel chooses the clock of the cores."""
    found = set()
    for path in sysfs.glob("cpu[0-9]*/cpufreq/scaling_governor"):
        try:
            found.add(path.read_text().strip())
        except OSError:
            continue
    slow = "powersave" in found and not (sysfs / "intel_pstate").exists()
    return Finding(
        what="CPU governor",
        found=", ".join(sorted(found)) or "not told by this kernel",
        needed="performance or schedutil",
        verdict=Verdict.WARN if slow else Verdict.OK,
        advice="sudo cpupower frequency-set -g performance" if slow else "",
    )


def disk(where: Path) -> Finding:
    """Look how much room there is for results and recordings."""
    place = where
    while not place.exists():
        place = place.parent
    free_gb = shutil.disk_usage(place).free / 1e9
    verdict = Verdict.OK if free_gb >= _DISK_GB else Verdict.WARN if free_gb > 0.1 else Verdict.FAIL
    return Finding(
        what="disk",
        found=f"{free_gb:.1f} GB free at {place}",
        needed=f"{_DISK_GB:g} GB",
        verdict=verdict,
        advice="" if verdict is Verdict.OK else "make room, or run in another directory",
    )


def bus() -> Finding:
    """Open a hub and two peers on unix sockets, as a run does, and let messages go round."""
    from runtime.bus import links
    from runtime.bus.zenoh_bus import BusError, ZenohBus

    needed = "round trip under 5 ms"
    try:
        with tempfile.TemporaryDirectory(prefix="hw-") as folder:
            run_dir = Path(folder)
            with (
                ZenohBus(links.hub(run_dir)),
                ZenohBus(links.peer(run_dir, "a")) as near,
                ZenohBus(links.peer(run_dir, "b")) as far,
            ):
                far.answer("doctor", bytes)
                end = time.monotonic() + 3.0
                while not near.ask("doctor", b"?") and time.monotonic() < end:
                    time.sleep(0.02)
                trips_ms = []
                for _ in range(_ROUND_TRIPS):
                    began = time.perf_counter()
                    if near.ask("doctor", b"?") == [b"?"]:
                        trips_ms.append((time.perf_counter() - began) * 1e3)
    except BusError as error:
        return Finding(
            what="zenoh", found=str(error), needed=needed, verdict=Verdict.FAIL, advice="is /tmp writable?"
        )
    if len(trips_ms) < _ROUND_TRIPS:
        found = f"{len(trips_ms)} of {_ROUND_TRIPS} messages came back"
        return Finding(
            what="zenoh", found=found, needed=needed, verdict=Verdict.FAIL, advice="is a firewall in the way?"
        )
    trips_ms.sort()
    half, worst = trips_ms[len(trips_ms) // 2], trips_ms[-1]
    good = half < 5.0
    return Finding(
        what="zenoh",
        found=f"round trip {half:.2f} ms (median), {worst:.2f} ms (worst of {_ROUND_TRIPS})",
        needed=needed,
        verdict=Verdict.OK if good else Verdict.WARN,
        advice="" if good else "end what burdens this machine",
    )


def robot(name: str) -> Finding | None:
    """Look whether the robot of this name can be reached; None if none runs here."""
    from runtime import rundir
    from runtime.access import gate
    from runtime.bus.zenoh_bus import BusError, ZenohBus

    if not rundir.is_running(name):
        return None
    try:
        with ZenohBus(gate.visit(name)) as visiting:
            processes = len(visiting.tokens("@ros2_lv/**/NN/**"))
    except BusError as error:
        return Finding(
            what="robot",
            found=str(error),
            needed="reachable",
            verdict=Verdict.FAIL,
            advice=f"end it and start it again: hallway up, robot {name}",
        )
    return Finding(what="robot", found=f"{name} runs, {processes} processes", needed="reachable")
