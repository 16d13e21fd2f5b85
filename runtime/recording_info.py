"""What a recording holds and what it lacks, from one pass over the file, finished or cut."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.formats.mcap_log import Gaps, McapReader
from runtime.messages import BadMessageError, decode
from runtime.recording import DISK_FULL, END_RECORD, STATUS_TOPIC, STATUS_TYPE

MOST_GAPS = 20
"""Gaps that are listed one by one; the rest is in the sums."""


@dataclass(slots=True)
class _Row:
    type: str
    first_ns: int
    last_ns: int = 0
    messages: int = 0
    bytes: int = 0


def describe(path: Path) -> dict[str, Any]:
    """Return everything that `hallway info` says about a recording, as plain values.

    Raises:
        FormatError: It is no MCAP file.
    """
    reader = McapReader(path)
    gaps = Gaps()
    rows: dict[str, _Row] = {}
    publishers: dict[str, set[str]] = {}
    status = b""
    for message in reader.messages():
        channel = message.channel
        if channel.name == STATUS_TOPIC and channel.msgtype == STATUS_TYPE:
            status = message.payload
        row = rows.setdefault(channel.topic, _Row(channel.msgtype, message.log_ns))
        row.messages += 1
        row.bytes += len(message.payload)
        row.last_ns = max(row.last_ns, message.log_ns)
        publishers.setdefault(channel.topic, set()).add(channel.publisher)
        gaps.see(message)
    state = reader.state
    began_ns = min((row.first_ns for row in rows.values()), default=0)
    ended_ns = max((row.last_ns for row in rows.values()), default=0)
    missing = state.losses()
    missing += [f"{n} messages of {topic}, by its sequence numbers" for topic, n in gaps.missing.items()]
    missing += _told_losses(status)
    if state.metadata.get(END_RECORD, {}).get("ended") == DISK_FULL:
        missing.append(f"everything after its end, because {DISK_FULL}")
    return {
        "file": str(path),
        "kind": "MCAP recording",
        "size_mb": path.stat().st_size / 1e6,
        "began_s": began_ns / 1e9,
        "duration_s": (ended_ns - began_ns) / 1e9,
        "messages": sum(row.messages for row in rows.values()),
        "written_by": state.library,
        **{name: values for name, values in state.metadata.items() if values},
        "attachments": sorted(state.attachments),
        "topics": {
            name: {
                "type": row.type,
                "messages": row.messages,
                "rate_hz": _rate(row),
                "missing": gaps.missing.get(name, 0),
                "publishers": len(publishers[name]),
                "bytes": row.bytes,
            }
            for name, row in sorted(rows.items())
        },
        "gaps": [
            {"topic": topic, "at_s": (at_ns - began_ns) / 1e9, "first": first, "count": count}
            for topic, at_ns, first, count in gaps.where[:MOST_GAPS]
        ],
        "notices": [one for one in state.troubles() if one not in missing],
        "missing": missing,
    }


def _rate(row: _Row) -> float | None:
    span_s = (row.last_ns - row.first_ns) / 1e9
    return (row.messages - 1) / span_s if row.messages > 1 and span_s > 0 else None


def _told_losses(status: bytes) -> list[str]:
    """Return what the recorder itself said it lost, by its last word in the file."""
    if not status:
        return []
    try:
        (last,) = decode(status, STATUS_TYPE).status
    except (BadMessageError, ValueError):
        return ["the recorder's own account is damaged"]
    counts = {one.key: one.value for one in last.values}
    told = []
    if counts.get("unwritten", "0") != "0":
        told.append(f"{counts['unwritten']} messages that came when the disk was full")
    for key, value in counts.items():
        if key.endswith(".lost"):
            topic = key.removesuffix(".lost")
            told.append(f"{value} messages of {topic} that the recorder did not get")
    return told
