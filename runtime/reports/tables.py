"""The tables of a report: values in words for people, nothing longer than a page is wide."""

import html
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from runtime.latency import HOPS


def facts_table(title: str, values: Mapping[str, Any]) -> str:
    """Return a heading and a row for each value, also for those inside others; nothing without a row."""
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{html.escape(text)}</td></tr>" for name, text in flat(values)
    )
    return f'<h2>{title}</h2><table class="facts">{rows}</table>' if rows else ""


def flat(values: Mapping[str, Any], inside: str = "") -> Iterator[tuple[str, str]]:
    """Yield names and texts; what holds others gives each of them its name; what is None is left out."""
    for name, value in values.items():
        full = f"{inside}, {name}" if inside else name
        if isinstance(value, Mapping):
            yield from flat(value, full)
        elif value is not None:
            yield full, _text(value)


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(map(_text, value)) or "none"
    return str(value)


def latency_table(hops_ms: Mapping[str, Mapping[str, float]]) -> str:
    """Return p50, p99 and the greatest of each hop, and what the hop is."""
    if not hops_ms:
        return ""
    rows = "".join(
        f"<tr><td>{html.escape(hop)}</td>"
        + "".join(f"<td>{values.get(q, float('nan')):.1f}</td>" for q in ("p50", "p99", "max"))
        + f'<td class="quiet">{html.escape(HOPS.get(hop, ""))}</td></tr>'
        for hop, values in hops_ms.items()
    )
    head = "<tr><th>hop</th><th>p50</th><th>p99</th><th>max</th><th></th></tr>"
    return f'<h2>Latency, ms</h2><table class="numbers">{head}{rows}</table>'
