"""Recordings after the fact: cut files made whole again, and the files of a ring kept before it goes on."""

import errno
import os
import shutil
import time
from pathlib import Path

from runtime.formats.errors import FormatError
from runtime.formats.mcap_log import ACTIVE_SUFFIX, McapReader
from runtime.formats.mcap_writer import McapWriter, is_written
from runtime.recordings.names import ring_files, unfinished


def keep_ring(ring: Path, folder: Path, within_s: float) -> list[Path]:
    """Keep what is in a ring now: give each of its files a second name, in another folder of the same disk.

    The file that is being written is waited for, so that what follows the call for a moment is in it too.

    Args:
        ring: `X.mcap` of a recorder whose ring is in the files `X_NNNNNNNN.mcap`.
        folder: Where the files are kept.
        within_s: How long the newest file is waited for; it is kept as it is then.

    Returns:
        The kept files, oldest first.
    """
    folder.mkdir(parents=True, exist_ok=True)
    kept = []
    for path in ring_files(ring):
        # The ring goes on meanwhile: the newest file may have got its name since, the oldest may be gone.
        for name in dict.fromkeys((path.name, path.name.removesuffix(ACTIVE_SUFFIX))):
            try:
                _link(path.with_name(name), folder / name)
            except FileNotFoundError:
                continue
            kept.append(folder / name)
            break
    end = time.monotonic() + within_s
    for index, path in enumerate(kept):
        if path.suffix != ACTIVE_SUFFIX:
            continue
        with path.open("r+b") as file:
            while is_written(file) and time.monotonic() < end:
                time.sleep(0.1)
        if McapReader.is_whole(path):
            kept[index] = path.rename(path.with_suffix(""))
    return kept


def _link(path: Path, target: Path) -> None:
    """Give a file a second name; a copy where the disk is another one, or knows no second names."""
    try:
        os.link(path, target)
    except OSError as error:
        if error.errno == errno.ENOENT:
            raise
        shutil.copyfile(path, target)


def recover_cut(recording: Path) -> list[str]:
    """Make whole files of those that earlier recordings of this name left unfinished.

    What another recorder still writes is left alone, and so is what cannot be read or made whole.

    Args:
        recording: `X.mcap`; its own unfinished file is meant, and those of its parts `X_NNN.mcap`.

    Returns:
        For each unfinished file what became of it, in words.
    """
    told = map(_recover, unfinished(recording))
    return [line for line in told if line]


def _recover(cut: Path) -> str:
    """Make a cut file whole and say so; nothing is said of a file that is not cut."""
    whole = cut.with_name(cut.name.removesuffix(ACTIVE_SUFFIX))
    try:
        with cut.open("r+b") as file:
            if whole.exists() or is_written(file):
                return ""
            if not file.read(1):
                cut.unlink()
                return f"{cut}: was empty, from a recorder that was killed as it began; taken away"
            count = salvage(cut)[1]
            cut.unlink()
    except FileNotFoundError:
        return ""  # whoever wrote it has just finished it
    except FormatError as error:
        return f"{error}; left as it is"
    except OSError as error:
        return f"{cut}: cannot be recovered: {error.strerror}; left as it is"
    return f"{whole}: {count} messages recovered from a recording that was cut"


def salvage(path: Path, target: Path | None = None) -> tuple[Path, int, list[str]]:
    """Copy everything readable of a cut or damaged file into a whole one, and read that again.

    Args:
        path: The damaged file, usually `X.mcap.active`.
        target: The new file; by default the name without `.active`, or `X.recovered.mcap`.

    Returns:
        The new file, how many messages it holds, and what of the old one could not be read.

    Raises:
        FormatError: It is no MCAP file, or cannot be read back.
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
    partial.with_name(partial.name + ACTIVE_SUFFIX).unlink(missing_ok=True)  # of one that was killed at it
    writer = McapWriter(partial, about, state.attachments)
    try:
        count = 0
        for message in reader.messages():
            writer.add(message.channel, message.sequence, message.log_ns, message.publish_ns, message.payload)
            count += 1
        writer.finish()
        again = McapReader(partial)
        found = sum(1 for _ in again.messages())
        if found != count or again.state.troubles():
            raise FormatError(
                path, f"{found} of {count} messages read back after recovery; is the disk sound?"
            )
    except Exception:
        writer.abandon()
        for file in (partial, writer.active_path):
            file.unlink(missing_ok=True)
        raise
    partial.rename(target)
    return target, count, state.losses()
