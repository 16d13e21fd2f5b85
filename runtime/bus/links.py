"""Who listens where, and who talks with whom: the configuration of every session on the bus, as plain values.

Law: by default nothing listens on a network. The processes of one robot are peers on unix sockets in a
directory that only its owner may enter; one hub introduces them to each other and then stands aside.
Multicast and shared memory are off: the first finds strangers, the second stalls and leaks.
"""

from pathlib import Path
from typing import Any

from runtime.errors import ConfigError

LOCAL = "unixsock-stream"
LEASE_MS = 2000
"""A peer that is silent for so long is gone. A shorter lease would drop a peer that compiles its kernels."""
_SOCKET_PATH_MAX = 107  # sun_path of the kernel, without its closing zero

BASE: dict[str, Any] = {
    "scouting": {
        "multicast": {"enabled": False},
        "delay": 200,
        "gossip": {
            "enabled": True,
            "target": {"router": ["router", "peer"], "peer": ["router"]},
            "autoconnect_strategy": {"peer": {"to_router": "always", "to_peer": "greater-zid"}},
        },
    },
    "transport": {"shared_memory": {"enabled": False}, "link": {"tx": {"lease": LEASE_MS}}},
    "connect": {"retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2}},
}


def merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Return `base` with the values of `over` on top, section by section."""
    result = dict(base)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = merged(result[key], value) if both else value
    return result


def socket(run_dir: Path, name: str) -> str:
    """Return the endpoint of one process of a run.

    Raises:
        ConfigError: The path is longer than the kernel takes.
    """
    path = run_dir / f"{name}.sock"
    if len(str(path)) > _SOCKET_PATH_MAX:
        raise ConfigError(
            f"{path}: a socket's path has at most {_SOCKET_PATH_MAX} characters, got {len(str(path))}"
        )
    return f"{LOCAL}/{path}"


def only(*protocols: str) -> dict[str, Any]:
    """Return what keeps a session to some kinds of links, whomever it hears of.

    The hub tells its peers of a guest that calls itself a peer and says where it listens. Were they to dial
    it, they would talk past the rules that the hub keeps.
    """
    return {"transport": {"link": {"protocols": list(protocols)}}}


def peer(run_dir: Path, name: str) -> dict[str, Any]:
    """Return the session of a process on the robot."""
    return merged(
        merged(BASE, only(LOCAL)),
        {
            "mode": "peer",
            "listen": {"endpoints": [socket(run_dir, name)]},
            "connect": {"endpoints": [socket(run_dir, "hub")]},
        },
    )


def visitor(run_dir: Path) -> dict[str, Any]:
    """Return the session of a command that looks at a robot of this machine; it listens nowhere."""
    return merged(
        merged(BASE, only(LOCAL)),
        {
            "mode": "client",
            "connect": {"endpoints": [socket(run_dir, "hub")], "timeout_ms": 2000, "exit_on_failure": True},
        },
    )


def hub(run_dir: Path, gate: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the session of the hub; with a `gate` also for guests from outside, or on to another hub."""
    protocols = (LOCAL,) if gate is None else (LOCAL, "tls")
    listen = {"mode": "router", "listen": {"endpoints": [socket(run_dir, "hub")]}}
    inside = merged(merged(BASE, only(*protocols)), listen)
    if gate is None:
        return inside
    endpoints = [*inside["listen"]["endpoints"], *gate.get("listen", {}).get("endpoints", [])]
    return merged(merged(inside, gate), {"listen": {"endpoints": endpoints}})
