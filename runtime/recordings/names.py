"""Names of the files of one recording: `X.mcap`, or with a number for each part or file of a ring."""

import re
from collections.abc import Iterator
from pathlib import Path

from runtime.formats.mcap_log import ACTIVE_SUFFIX

SPLIT_DIGITS, RING_DIGITS = 3, 8
"""Of the numbers; a ring goes on for weeks, and its names must sort."""


def numbered(base: Path, number: int, digits: int) -> Path:
    """Return the name of one file of several."""
    return base.with_name(f"{base.stem}_{number:0{digits}d}{base.suffix}")


def number_of(path: Path) -> int:
    """Return the number in such a name."""
    return int(path.stem.rsplit("_", 1)[-1])


def ring_files(base: Path) -> list[Path]:
    """Return what stands in a ring now, whole, cut or being written, oldest first."""
    return sorted(_matching(base, rf"_\d{{{RING_DIGITS}}}", f"({re.escape(ACTIVE_SUFFIX)})?"))


def earlier_in_ring(base: Path) -> list[Path]:
    """Return the files that an earlier recorder left in a ring, by the names they have when whole."""
    return sorted({one.with_name(one.name.removesuffix(ACTIVE_SUFFIX)) for one in ring_files(base)})


def unfinished(base: Path) -> list[Path]:
    """Return the files of a recording, its own or numbered ones, that are being written or were cut."""
    return sorted(_matching(base, rf"(_\d{{{SPLIT_DIGITS},}})?", re.escape(ACTIVE_SUFFIX)))


def _matching(base: Path, number: str, end: str) -> Iterator[Path]:
    pattern = re.compile(re.escape(base.stem) + number + re.escape(base.suffix) + end)
    found = base.parent.iterdir() if base.parent.is_dir() else iter(())
    return (one for one in found if pattern.fullmatch(one.name))
