"""Recordings after the fact: cut files made whole again, and the files of a ring kept before it goes on."""

import errno
import os
import shutil
import time
from pathlib import Path

from runtime.formats.mcap_log import ACTIVE_SUFFIX, McapReader
from runtime.formats.mcap_writer import McapWriter


def keep_ring(ring: Path, folder: Path, within_s: float) -> list[Path]:
    """Keep what is in a ring now: give each of its files a second name, in another folder of the same disk.

    The file that is being written is waited for, so that what follows the call for a moment is in it too.

    Args:
        ring: Folder in which a recorder keeps its ring.
        folder: Where the files are kept.
        within_s: How long the newest file is waited for; it is kept as it is then.

    Returns:
        The kept files, oldest first.
    """
    folder.mkdir(parents=True, exist_ok=True)
    kept = []
    for path in sorted(ring.glob("*.mcap*")):
        target = folder / path.name
        try:
            os.link(path, target)
        except OSError as error:
            if error.errno == errno.ENOENT:
                continue  # the ring went on in this moment; that file was the oldest
            shutil.copyfile(path, target)  # another disk
        kept.append(target)
    end = time.monotonic() + within_s
    for index, path in enumerate(kept):
        if path.suffix != ACTIVE_SUFFIX:
            continue
        while (ring / path.name).exists() and time.monotonic() < end:
            time.sleep(0.1)
        if not (ring / path.name).exists() and McapReader.is_whole(path):
            kept[index] = path.rename(path.with_suffix(""))
    return kept


def salvage(path: Path, target: Path | None = None) -> tuple[Path, int, list[str]]:
    """Copy everything readable of a cut or damaged file into a whole one, and read that again.

    Args:
        path: The damaged file, usually `X.mcap.active`.
        target: The new file; by default the name without `.active`, or `X.recovered.mcap`.

    Returns:
        The new file, how many messages it holds, and what of the old one could not be read.

    Raises:
        FormatError: It is no MCAP file.
        FileExistsError: The target exists.
    """
    if target is None:
        whole = path.name.removesuffix(ACTIVE_SUFFIX)
        target = path.with_name(whole if whole != path.name else f"{path.stem}.recovered.mcap")
    if target.exists():
        raise FileExistsError(17, "exists already", str(target))
    reader = McapReader(path)
    for _ in reader.messages():
        pass  # the first pass finds metadata and attachments, which stand before and behind messages
    state = reader.state
    about = dict(state.metadata)
    about["hallway.salvaged"] = {"from": path.name, "troubles": "; ".join(state.troubles()) or "none"}
    partial = target.with_name(f".{target.name}.salvage")
    writer = McapWriter(partial, about, state.attachments)
    count = 0
    for message in reader.messages():
        writer.add(message.channel, message.sequence, message.log_ns, message.publish_ns, message.payload)
        count += 1
    writer.finish()
    again = McapReader(partial)
    found = sum(1 for _ in again.messages())
    if found != count or again.state.troubles():
        raise AssertionError(f"{partial}: {found} of {count} messages read back after recovery")
    partial.rename(target)
    return target, count, state.losses()
