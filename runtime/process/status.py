"""What a robot looks like at one moment, put together from what its processes say of themselves."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from runtime.bus.offset import Offset
from runtime.latency import HOPS
from runtime.process.health import LOOP_AGE_S, Vital, number_of

SUPERVISOR = "supervisor"
"""On the robot's own machine; on others with more behind it."""
ELSEWHERE = "elsewhere"
"""State of a process on another machine, as long as its own supervisor is not heard."""
MATCHER, MAPPER, MONITOR = "matcher", "mapper", "monitor"
_STALE_S = 3.0


@dataclass(frozen=True, slots=True)
class ProcessLine:
    """One process, for people."""

    name: str
    state: str
    """Of its life, as `runtime.supervision.child.State` has it."""
    level: str
    text: str
    pid: int
    restarts: int
    cpu_percent: float
    rss_mb: float
    lost: int
    """Messages that arrived and were not taken, or never arrived."""
    duplicates: int
    """Messages that arrived again."""
    deadline_misses: int
    queue_ms: float
    """Age of a message when it is taken, p99 of the last minute of the slowest subscription."""
    host: str = ""
    """Machine that it runs on; empty for the robot's own."""


@dataclass(frozen=True, slots=True)
class Status:
    """One robot at one moment."""

    robot: str
    tracking: str
    """TRACKING, DEGENERATE, LOST, or nothing yet."""
    map_size: str
    scans: int
    mapped: int
    rates_hz: dict[str, float]
    hops_ms: dict[str, dict[str, float]]
    """p50, p99 and max of each hop of `runtime.latency.HOPS`, in the last minute."""
    processes: tuple[ProcessLine, ...]
    clock: Offset | None = None
    """Of the robot, against ours; None where that was not measured."""

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        values = dataclasses.asdict(self)
        del values["clock"]
        offset_ns = self.clock.offset_ns if self.clock else None
        round_trip_ns = self.clock.round_trip_ns if self.clock else None
        return values | {"clock_offset_ns": offset_ns, "clock_round_trip_ns": round_trip_ns}

    def line(self) -> str:
        """Return it in one line, without what is wrong; see `troubles`."""
        parts = [self.tracking or "starting"]
        rates = [f"{name} {rate:.1f}/s" for name, rate in self.rates_hz.items() if not name.startswith("map")]
        if rates:
            parts.append(" ".join(rates))
        for hop in ("match", "map"):
            if hop in self.hops_ms:
                parts.append(f"{hop} {self.hops_ms[hop]['p50']:.0f}/{self.hops_ms[hop]['p99']:.0f} ms")
        if "whole" in self.hops_ms:
            whole = self.hops_ms["whole"]
            parts.append(f"ray to pose {whole['p50']:.0f}/{whole['p99']:.0f} ms")
        if self.map_size:
            parts.append(f"map {self.map_size}")
        if self.scans:
            parts.append(f"{self.mapped} of {self.scans} scans")
        if self.clock is not None:
            parts.append(f"clock {self.clock}")
        return " | ".join(parts)

    def troubles(self) -> dict[str, str]:
        """Return what is wrong, by the process that says so."""
        return {p.name: p.text or p.state for p in self.processes if p.level != "ok"}


def status_of(robot: str, vitals: Mapping[str, Vital], clock: Offset | None = None) -> Status:
    """Put the last words of all processes together, and how far its clock is from ours where we know it."""
    monitor, matcher = vitals.get(MONITOR), vitals.get(MATCHER)
    return Status(
        robot=robot,
        tracking=_tracking(matcher),
        map_size=vitals[MAPPER].values.get("map_size", "") if MAPPER in vitals else "",
        scans=int(monitor.number("scans")) if monitor else 0,
        mapped=int(monitor.number("mapped")) if monitor else 0,
        rates_hz=_rates(monitor),
        hops_ms=_hops(vitals),
        processes=tuple(_lines(vitals)),
        clock=clock,
    )


def _tracking(matcher: Vital | None) -> str:
    if matcher is None:
        return ""
    state = matcher.values.get("state", "")
    return f"{state} (stale)" if state and matcher.age_s > _STALE_S else state


def _rates(monitor: Vital | None) -> dict[str, float]:
    if monitor is None:
        return {}
    ending = ".rate_hz"
    return {key.removesuffix(ending): monitor.number(key) for key in monitor.values if key.endswith(ending)}


def _hops(vitals: Mapping[str, Vital]) -> dict[str, dict[str, float]]:
    """Return the hops that the monitor follows, and the last one, that only whoever draws can know."""
    hops: dict[str, dict[str, float]] = {}
    for hop in HOPS:
        for vital in vitals.values():
            if f"latency.{hop}.p50_ms" in vital.values and not vital.has_left:
                hops[hop] = {q: vital.number(f"latency.{hop}.{q}_ms") for q in ("p50", "p99", "max")}
                break
    return hops


def _lines(vitals: Mapping[str, Vital]) -> list[ProcessLine]:
    supervisor = vitals.get(SUPERVISOR)
    told = _told(vitals)
    names = [key.split(".")[1] for key in told if key.endswith(".state")]
    guests = [name for name in vitals if name not in names]
    names += [name for name in guests if not _is_gone(vitals[name], supervisor)]
    lines: list[ProcessLine] = []
    for name in names:
        vital = vitals.get(name)
        state, reason = told.get(f"child.{name}.state", ""), told.get(f"child.{name}.reason", "")
        level, text = (vital.level, vital.text) if vital else ("ok", "")
        if state in ("backoff", "failed"):
            level, text = "error", reason
        elif vital is not None and vital.age_s > _STALE_S and state in ("", "running", ELSEWHERE):
            level, text = "stale", f"not heard for {vital.age_s:.0f} s"
        elif vital is not None and state in ("", "running", ELSEWHERE) and _stands_s(vital) > _STALE_S:
            level, text = "stale", f"its loop has not turned for {_stands_s(vital):.0f} s"
        elif vital is None and state == ELSEWHERE:
            level, text = "stale", "not heard yet"
        values = vital.values if vital else _seen_by(told, name)
        ages = [number_of(values, key) for key in values if key.endswith(".queue_ms")]
        lines.append(
            ProcessLine(
                name=name,
                state=state or ("running" if vital else ""),
                level=level,
                text=text,
                pid=int(number_of(values, "pid")),
                restarts=int(number_of(told, f"child.{name}.restarts")),
                cpu_percent=number_of(values, "cpu_percent"),
                rss_mb=number_of(values, "rss_mb"),
                lost=_sum(values, (".overwritten", ".missed", "scans_skipped")),
                duplicates=_sum(values, (".duplicates",)),
                deadline_misses=_sum(values, (".deadline_misses",)),
                queue_ms=max(ages, default=0.0),
                host=told.get(f"child.{name}.host", ""),
            )
        )
    return lines


def _stands_s(vital: Vital) -> float:
    """Return how long ago the loop of a process that is ready had turned when it last spoke."""
    return vital.number(LOOP_AGE_S) if vital.number("ready") else 0.0


def _told(vitals: Mapping[str, Vital]) -> dict[str, str]:
    """Return what the supervisors of all machines tell of their processes; that of the robot speaks first."""
    told = dict(vitals[SUPERVISOR].values) if SUPERVISOR in vitals else {}
    for name, vital in vitals.items():
        if name.startswith(f"{SUPERVISOR}_") and not vital.has_left and vital.age_s <= _STALE_S:
            told |= {key: value for key, value in vital.values.items() if key.startswith("child.")}
    return told


def _seen_by(told: Mapping[str, str], name: str) -> dict[str, str]:
    """Return what a supervisor tells of a process that says nothing of itself, as the hub."""
    start = f"child.{name}."
    return {key.removeprefix(start): value for key, value in told.items() if key.startswith(start)}


def _is_gone(guest: Vital, supervisor: Vital | None) -> bool:
    """Whether somebody who is no process of the run has left, which is no fault of the robot's.

    Said, or because nothing was heard: a link that was cut takes the last word along.
    """
    known = supervisor is not None and guest is not supervisor
    return guest.has_left or (known and guest.age_s > _STALE_S)


def _sum(values: Mapping[str, str], endings: tuple[str, ...]) -> int:
    return sum(int(value) for key, value in values.items() if key.endswith(endings) and value.isdigit())
