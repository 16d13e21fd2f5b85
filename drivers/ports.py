"""Which ports there are, what is plugged into them, and who holds them: read from sysfs and procfs only."""

import contextlib
import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class UsbPort:
    """A serial port that a USB device provides."""

    path: str
    """The node to open, e.g. /dev/ttyACM0; it may change with every plugging."""
    vendor: str
    product: str
    location: str
    """Where on the bus it is plugged, e.g. 1-2.3: the same as long as nobody moves the cable."""
    name: str
    """What the device calls itself, for people."""


@dataclass(frozen=True, slots=True)
class Holder:
    """A process that has a port open."""

    pid: int
    name: str

    def __str__(self) -> str:
        return f"{self.name} (process {self.pid})"


def usb_ports(
    vendor: str, product: str, *, sysfs: Path = Path("/sys"), dev: Path = Path("/dev")
) -> list[UsbPort]:
    """List the serial ports of USB devices of this identity (four hex digits each), by place on the bus."""
    found = []
    for tty in sorted((sysfs / "class" / "tty").glob("tty*")):
        device = _usb_device(tty)
        if device is None:
            continue
        if (_text(device / "idVendor"), _text(device / "idProduct")) != (vendor.lower(), product.lower()):
            continue
        found.append(UsbPort(str(dev / tty.name), vendor, product, device.name, _text(device / "product")))
    return sorted(found, key=lambda port: (port.location, port.path))


def holders(path: str, *, procfs: Path = Path("/proc")) -> list[Holder]:
    """List the other processes that have `path` open, as far as this user may see them."""
    real = os.path.realpath(path)
    found = []
    for process in procfs.glob("[0-9]*"):
        if int(process.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):  # processes end while one looks, and others belong to other users
            if any(_link(fd) == real for fd in (process / "fd").iterdir()):
                found.append(Holder(int(process.name), _text(process / "comm")))
    return sorted(found, key=lambda holder: holder.pid)


def _usb_device(tty: Path) -> Path | None:
    """Climb from a tty to the USB device above it; None for ports that are not on USB."""
    interface = tty / "device"
    if not interface.exists():
        return None
    for folder in (resolved := interface.resolve(), *resolved.parents[:4]):
        if (folder / "idVendor").exists():
            return folder
    return None


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""


def _link(path: Path) -> str:
    try:
        return os.readlink(path)
    except OSError:
        return ""
