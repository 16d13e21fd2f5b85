"""Who may come to the robot from outside: its authority, a certificate for each guest, a list of their roles.

A robot makes its authority once; each guest gets one file with everything a laptop needs to come back. The
list decides: a guest who is struck off it may still knock, and sees and moves nothing. Private keys stay in
files that only their owner may read; they are in no log, no recording, no command line.
"""

import contextlib
import ipaddress
import json
import os
import re
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from runtime.access.certificates import Certificates
from runtime.errors import ConfigError

PORT = 7448
Role = Literal["viewer", "operator", "machine"]
ROLES: tuple[Role, ...] = get_args(Role)
"""Each may what those before it may: look; drive; run processes of the robot's graph."""
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,40}\Z")
_LABEL = re.compile(r"[A-Za-z0-9_]([A-Za-z0-9_-]{0,61}[A-Za-z0-9_])?\Z")
_LONGEST_NAME = 253
"""Of DNS, and the parts of one between its dots."""
_VARIABLE = "HALLWAY_KEYS"


def base_dir() -> Path:
    """Return where the keys of this user are."""
    if named := os.environ.get(_VARIABLE):
        return Path(named)
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path("~/.config").expanduser()) / "hallway" / "keys"


@dataclass(frozen=True, slots=True)
class Authority:
    """What the hub needs to let guests in."""

    folder: Path

    @property
    def ca(self) -> Path:
        """Certificate of the authority."""
        return self.folder / "ca.crt"

    @property
    def certificate(self) -> Path:
        """Of the hub."""
        return self.folder / "hub.crt"

    @property
    def key(self) -> Path:
        """Of the hub, private."""
        return self.folder / "hub.key"

    def roster(self) -> dict[str, Role]:
        """Return the role of each guest; raises ConfigError if the list is damaged."""
        path = self.folder / "roster.json"
        try:
            listed = json.loads(path.read_text(encoding="utf-8"))
            return {str(name): role for name, role in listed.items() if role in ROLES}
        except FileNotFoundError:
            return {}
        except (ValueError, AttributeError) as error:
            raise ConfigError(f"{path}: is no list of guests: {error}") from error

    def write_roster(self, roster: dict[str, Role]) -> None:
        """Replace the list of guests."""
        text = json.dumps(roster, indent=2, sort_keys=True) + "\n"
        _write(self.folder / "roster.json", text.encode(), private=True)


@dataclass(frozen=True, slots=True)
class Invitation:
    """What a guest needs to come to a robot; one file."""

    robot: str
    address: str
    """`host:port` of the robot."""
    guest: str
    role: str
    key: str
    certificate: str
    ca: str
    """The last three as PEM."""

    def to_bytes(self) -> bytes:
        """Return the file."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return (json.dumps({"hallway": "invitation", **values}, indent=1) + "\n").encode()

    @classmethod
    def read(cls, path: Path) -> "Invitation":
        """Read the file; raises ConfigError."""
        try:
            values: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            if values.pop("hallway") != "invitation":
                raise KeyError
            return cls(**{str(key): str(value) for key, value in values.items()})
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ConfigError(f"{path}: is no invitation of a robot") from error


def authority(robot: str) -> Authority:
    """Return the authority of a robot of this user; raises ConfigError if it was never made."""
    found = Authority(base_dir() / robot)
    if not found.key.exists():
        raise ConfigError(
            f"{found.folder}: robot {robot!r} has no keys yet; make them with: hallway keys make"
        )
    return found


def make(robot: str, hosts: Sequence[str] = ()) -> Authority:
    """Make the authority of a robot and the certificate of its hub.

    Args:
        robot: Its name.
        hosts: Names and addresses under which guests reach it, besides those it has now.

    Raises:
        ConfigError: It has keys already, and making others would lock all guests out; a host is neither name
            nor address.
    """
    for host in hosts:
        if not _is_host(host):
            raise ConfigError(f"host = {host!r}, must be a DNS name or an IP address, without a port")
    made = Authority(base_dir() / robot)
    if made.key.exists():
        raise ConfigError(f"{made.folder}: holds keys already; remove the folder to lock all guests out")
    x509 = Certificates()
    ca_key = x509.new_key()
    ca = x509.certificate(f"hallway {robot}", ca_key, None, None, authority=True)
    own = (socket.gethostname(), f"{socket.gethostname()}.local", "localhost")
    names = [*hosts, *own_addresses(), *filter(_is_host, own)]
    key = x509.new_key()
    certificate = x509.certificate(f"hub {robot}", key, ca, ca_key, names=tuple(dict.fromkeys(names)))
    made.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    _write(made.folder / "ca.key", x509.key_pem(ca_key), private=True)
    _write(made.ca, x509.certificate_pem(ca))
    _write(made.key, x509.key_pem(key), private=True)
    _write(made.certificate, x509.certificate_pem(certificate))
    made.write_roster({})
    return made


def invite(robot: str, guest: str, role: Role, address: str) -> Invitation:
    """Put a guest on the list and return what it needs; raises ConfigError."""
    if not _NAME.match(guest):
        raise ConfigError(f"guest = {guest!r}, must be lower-case letters, digits, '-' and '_'")
    if not (_is_host(address) or _is_host(address.rpartition(":")[0].strip("[]"))):
        raise ConfigError(f"address = {address!r}, must be HOST or HOST:PORT, a DNS name or an IP address")
    host = authority(robot)
    if guest in (roster := host.roster()):
        raise ConfigError(f"guest {guest!r} is on the list already, as {roster[guest]}; revoke it first")
    x509 = Certificates()
    ca, ca_key = x509.load(host.ca.read_bytes(), (host.folder / "ca.key").read_bytes())
    key = x509.new_key()
    certificate = x509.certificate(common_name(guest), key, ca, ca_key)
    host.write_roster({**roster, guest: role})
    return Invitation(
        robot=robot,
        address=address if ":" in address else f"{address}:{PORT}",
        guest=guest,
        role=role,
        key=x509.key_pem(key).decode(),
        certificate=x509.certificate_pem(certificate).decode(),
        ca=host.ca.read_text(encoding="ascii"),
    )


def revoke(robot: str, guest: str) -> None:
    """Strike a guest off the list; a hub that runs has thrown it out within a second."""
    host = authority(robot)
    roster = host.roster()
    if guest not in roster:
        raise ConfigError(f"guest {guest!r}: not on the list; on it: {', '.join(roster) or 'nobody'}")
    host.write_roster({name: role for name, role in roster.items() if name != guest})


def pair(file: Path) -> Invitation:
    """Keep an invitation, so that the robot's name is enough from now on."""
    invitation = Invitation.read(file)
    if not _NAME.match(invitation.robot):
        raise ConfigError(f"{file}: robot = {invitation.robot!r}, must be lower-case letters and digits")
    folder = base_dir() / "paired"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    _write(folder / f"{invitation.robot}.json", invitation.to_bytes(), private=True)
    return invitation


def paired(robot: str) -> Invitation | None:
    """Return the invitation to a robot that was kept here."""
    path = base_dir() / "paired" / f"{robot}.json"
    return Invitation.read(path) if path.exists() else None


def common_name(guest: str) -> str:
    """Return the name in a guest's certificate."""
    return f"guest {guest}"


def own_addresses() -> list[str]:
    """Return the addresses of this machine that others can reach."""
    import psutil

    found: list[str] = []
    for addresses in psutil.net_if_addrs().values():
        for one in addresses:
            if one.family in (socket.AF_INET, socket.AF_INET6):
                address = ipaddress.ip_address(one.address.partition("%")[0])
                if not address.is_link_local:
                    found.append(str(address))
    return found


def write_private(path: Path, data: bytes) -> None:
    """Write a file in one step that only its owner may read; raises ConfigError."""
    _write(path, data, private=True)


def _write(path: Path, data: bytes, *, private: bool = False) -> None:
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        descriptor = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600 if private else 0o644)
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            fresh.unlink()  # it may hold half a key
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error


def _is_host(text: str) -> bool:
    """Whether a guest can reach somebody under it: an IP address, or a DNS name."""
    try:
        ipaddress.ip_address(text)
    except ValueError:
        labels = text.split(".")
        return len(text) <= _LONGEST_NAME and all(map(_LABEL.match, labels)) and not labels[-1].isdigit()
    return True
