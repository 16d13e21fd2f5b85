"""Holes as a table that people read."""

from collections.abc import Mapping, Sequence
from typing import Any

MOST_ROWS = 20
"""Holes that are listed one by one; the rest is in the sums."""


def print_gaps(title: str, gaps: Sequence[Mapping[str, Any]]) -> None:
    """Print topic, time, first number and count of each; nothing if there is none.

    Args:
        title: What is missing where.
        gaps: As `runtime.formats.missing.Account.gaps` returns them.
    """
    if not gaps:
        return
    print(f"{title:<28}{'time s':>12}{'first':>9}{'count':>8}")
    for gap in gaps[:MOST_ROWS]:
        row = f"{gap['topic']:<28}{gap['at_s']:>12.3f}{gap['first']:>9}{gap['count']:>8}"
        print(row)
    if len(gaps) > MOST_ROWS:
        print(f"and {len(gaps) - MOST_ROWS} more")
