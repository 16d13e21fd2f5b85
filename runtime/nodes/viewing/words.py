"""The text beside the map: how it goes, what that means, and what to do."""

from dataclasses import dataclass

from runtime.process.status import Status

STARTING = "STARTING"
"""The word before the first match."""
BUMPS = ("free", "bumped", "wheel drop")

_MEANINGS = {
    "TRACKING": "The scan fits in every direction.",
    "DEGENERATE": "One direction is not seen, as in a long corridor: the **orange line** shows it. "
    "Along it the motion so far is carried on until a corner comes into sight.",
    "LOST": "The scan fits nowhere. Drive slowly, back to where the map is dark and sharp.",
    "": "No match yet.",
}


@dataclass(slots=True)
class Base:
    """What the robot's base says of itself; percent is None where there is no base."""

    battery_percent: float | None = None
    bumper: str = BUMPS[0]


def words_of(status: Status, base: Base, matcher_text: str) -> str:
    """Return Markdown for one moment of a robot."""
    word = status.tracking.split(" ")[0]
    lines = [f"# {status.tracking or STARTING}", _MEANINGS.get(word, matcher_text)]
    facts = []
    whole = status.hops_ms.get("whole")
    if whole:
        facts.append(f"ray to pose **{whole['p50']:.0f} ms** (99 %: {whole['p99']:.0f} ms)")
    if "scan" in status.rates_hz:
        facts.append(f"**{status.rates_hz['scan']:.1f}** scans a second")
    if status.scans:
        facts.append(f"{status.mapped} of {status.scans} scans in the map")
    if status.map_size:
        facts.append(f"map {status.map_size}")
    if base.battery_percent is not None:
        facts.append(f"battery {base.battery_percent:.0f} %, bumper: {base.bumper}")
    lines += [" · ".join(facts)] if facts else []
    lines += [
        f"**{process.name}**: {process.text or process.state}"
        for process in status.processes
        if process.level != "ok"
    ]
    return "\n\n".join(lines)
