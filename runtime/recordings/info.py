"""What a recording holds and what it lacks, from one pass over the file, finished or cut."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.formats.mcap_log import McapReader
from runtime.formats.missing import Account


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
    account = Account()
    rows: dict[str, _Row] = {}
    publishers: dict[str, set[str]] = {}
    for message in reader.messages():
        channel = message.channel
        row = rows.setdefault(channel.topic, _Row(channel.msgtype, message.log_ns))
        row.messages += 1
        row.bytes += len(message.payload)
        row.last_ns = max(row.last_ns, message.log_ns)
        publishers.setdefault(channel.topic, set()).add(channel.publisher)
        account.see(message)
    state = reader.state
    account.end(state)
    began_ns = min((row.first_ns for row in rows.values()), default=0)
    ended_ns = max((row.last_ns for row in rows.values()), default=0)
    missing = account.losses()
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
                "missing": account.missing(name),
                "publishers": len(publishers[name]),
                "bytes": row.bytes,
            }
            for name, row in sorted(rows.items())
        },
        "gaps": account.gaps(began_ns),
        "outages": account.outages_told(began_ns),
        "notices": [one for one in state.troubles() if one not in missing],
        "missing": missing,
    }


def _rate(row: _Row) -> float | None:
    span_s = (row.last_ns - row.first_ns) / 1e9
    return (row.messages - 1) / span_s if row.messages > 1 and span_s > 0 else None
