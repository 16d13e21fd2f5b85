"""The port of the laser: is it there, may we open it, and does anybody else want it?"""

import getpass
import grp
import os
from pathlib import Path

from drivers.ports import Holder, UsbPort, holders, usb_ports
from drivers.urg04lx.device import USB_PRODUCT, USB_VENDOR
from runtime.cli.checkup.finding import Finding, Verdict

RULE = "60-hallway-urg.rules"
_RULE_DIRS = ("/etc/udev/rules.d", "/run/udev/rules.d", "/usr/lib/udev/rules.d", "/lib/udev/rules.d")
INSTALL_RULE = (
    f"hallway doctor --udev | sudo tee /etc/udev/rules.d/{RULE}"
    " && sudo udevadm control --reload && sudo udevadm trigger, then plug the sensor in again"
)


def find_port(wanted: str, on_usb: list[UsbPort] | None = None) -> tuple[str, Finding]:
    """Return the port to use ("" if there is none) and what to say about it.

    Args:
        wanted: A path, or "auto" for the first sensor on USB.
        on_usb: Sensors on USB; looked for if None.
    """
    found = usb_ports(USB_VENDOR, USB_PRODUCT) if on_usb is None else on_usb
    names = ", ".join(f"{port.path} (USB {port.location})" for port in found)
    if wanted == "auto":
        needed = f"a URG on USB ({USB_VENDOR}:{USB_PRODUCT})"
        if not found:
            advice = (
                "plug the sensor in; does `lsusb -d 15d1:` show it? If so: another cable, a powered hub."
                " On RS-232 give --port and --baud"
            )
            return "", _finding("port", "none", needed, Verdict.MISSING, advice)
        if len(found) > 1:
            advice = "several sensors: give `path` by place (/dev/serial/by-path/...) or `serial`"
            return found[0].path, _finding("port", names, needed, Verdict.WARN, advice)
        return found[0].path, _finding("port", names, needed)
    if not os.path.exists(wanted):
        advice = f"plug it in{f'; there is {names}' if names else ''}"
        return "", _finding("port", f"no {wanted}", "an existing port", Verdict.MISSING, advice)
    real = os.path.realpath(wanted)
    return wanted, _finding("port", wanted + (f" -> {real}" if real != wanted else ""), "an existing port")


def permission(path: str) -> Finding:
    """Look whether this user may open the port."""
    needed = "read and write"
    if os.access(path, os.R_OK | os.W_OK):
        return _finding("permission", "read and write", needed)
    group = _group_of(path)
    user = getpass.getuser()
    advice = f"sudo usermod -aG {group} {user}, then log out and in again; or the udev rule: {INSTALL_RULE}"
    return _finding("permission", f"denied to {user}; group {group}", needed, Verdict.FAIL, advice)


def holder(path: str, found: list[Holder] | None = None) -> Finding:
    """Look who has the port open."""
    others = holders(path) if found is None else found
    if not others:
        return _finding("held by", "nobody", "nobody")
    names = ", ".join(map(str, others))
    advice = "end it: " + "; ".join(
        "sudo systemctl stop ModemManager" if other.name == "ModemManager" else f"kill {other.pid}"
        for other in others
    )
    return _finding("held by", names, "nobody", Verdict.FAIL, advice)


def modem_manager(procfs: Path = Path("/proc"), rule_dirs: tuple[str, ...] = _RULE_DIRS) -> Finding:
    """Look whether ModemManager would take the sensor for a modem."""
    needed = "not running, or kept away by the udev rule"
    running = any(_comm(process) == "ModemManager" for process in procfs.glob("[0-9]*"))
    installed = any((Path(place) / RULE).exists() for place in rule_dirs)
    found = f"{'' if running else 'not '}running, udev rule {'' if installed else 'not '}installed"
    if running and not installed:
        return _finding("ModemManager", found, needed, Verdict.WARN, f"install the udev rule: {INSTALL_RULE}")
    if not installed:
        return _finding("ModemManager", found, needed, advice=f"for a name that stays: {INSTALL_RULE}")
    return _finding("ModemManager", found, needed)


def rule_text() -> str:
    """Return the udev rule that ships with the driver."""
    import importlib.resources

    return (importlib.resources.files("drivers.urg04lx") / RULE).read_text(encoding="utf-8")


def _group_of(path: str) -> str:
    try:
        return grp.getgrgid(os.stat(path).st_gid).gr_name
    except (KeyError, OSError):
        return "dialout"


def _comm(process: Path) -> str:
    try:
        return (process / "comm").read_text().strip()
    except OSError:
        return ""


def _finding(what: str, found: str, needed: str, verdict: Verdict = Verdict.OK, advice: str = "") -> Finding:
    return Finding(what=what, found=found, needed=needed, verdict=verdict, advice=advice)
