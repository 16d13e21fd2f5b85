"""The robot's one door to the network: mutual TLS, and for each guest what its role allows.

Without `--remote` there is no door. What a guest may do is decided in the hub, by the name in its
certificate and the list of guests; what no rule allows is denied.
"""

import base64
from collections.abc import Mapping
from typing import Any

from runtime import rundir
from runtime.access.keys import Authority, Invitation, Role, common_name, paired
from runtime.bus import links
from runtime.bus.offset import question_key
from runtime.topics import TOPICS

BATCH_BYTES = 16_384
"""What waits for a slow link: two batches of each urgency, and what the socket holds; as little as does."""
ROS_ROUTER = "tcp/localhost:7447"
"""Where the sessions of rmw_zenoh look for their router."""
_ANSWERED_ELSEWHERE = ("map", "keep")
"""Questions that a mapper and a recorder answer, wherever they run."""
_READ = ["read_in", "read_out"]
_ASKING = ["declare_subscriber", "query", "liveliness_query", "declare_liveliness_subscriber"]
_ANSWERING = ["put", "delete", "reply", "declare_queryable", "liveliness_token"]


def door(
    host: Authority, robot: str, domain: int, endpoint: str, roster: Mapping[str, Role]
) -> dict[str, Any]:
    """Return the hub's one door to the network: mutual TLS, and for each guest what its role allows.

    Everything is denied that no rule allows; a guest reads its robot's topics, an operator also sends
    `cmd_vel`, a machine also what its processes of the robot's graph say.

    Args:
        host: Keys.
        robot: Its name.
        domain: ROS domain.
        endpoint: `address:port` to listen at.
        roster: The role of each guest.
    """
    subjects: list[dict[str, Any]] = [{"id": "local", "link_protocols": ["unixsock-stream"]}]
    policies: list[dict[str, Any]] = [{"rules": ["all"], "subjects": ["local"]}]
    drive = [*_READ, "drive_in", "drive_out"]
    work = [*drive, "work_in", "work_out"]
    for role, rules in (("viewer", _READ), ("operator", drive), ("machine", work)):
        names = [common_name(guest) for guest, theirs in roster.items() if theirs == role]
        if names:
            subjects.append({"id": role, "link_protocols": ["tls"], "cert_common_names": names})
            policies.append({"rules": rules, "subjects": [role]})
    return {
        "listen": {"endpoints": [f"tls/{endpoint}#so_sndbuf={BATCH_BYTES}"]},
        "transport": {
            "link": {
                "tls": {
                    "root_ca_certificate": str(host.ca),
                    "listen_private_key": str(host.key),
                    "listen_certificate": str(host.certificate),
                    "enable_mtls": True,
                }
            },
            "unicast": {"compression": {"enabled": True}},
        },
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": _rules(f"{domain}/{robot}", domain, robot),
            "subjects": subjects,
            "policies": policies,
        },
    }


def _rules(topics: str, domain: int, robot: str) -> list[dict[str, Any]]:
    # A rule matches what it *includes*, and `**` includes no chunk that begins with '@': the caches of
    # latched topics and the tokens of ROS are named one by one.
    readable = [f"{topics}/**", f"{topics}/**/@adv/**", f"@ros2_lv/{domain}/**", f"hallway/{robot}/**"]
    drivable = [f"{topics}/cmd_vel/**"]
    said = [f"{topics}/{topic.name}/**" for topic in TOPICS.values() if topic.elsewhere]
    workable = [
        *(key for topic in said for key in (topic, f"{topic}/@adv/**")),
        *(question_key(robot, question) for question in _ANSWERED_ELSEWHERE),
        f"@ros2_lv/{domain}/**",
    ]

    def rule(name: str, flows: list[str], key_exprs: list[str], messages: list[str]) -> dict[str, Any]:
        return {
            "id": name,
            "permission": "allow",
            "flows": flows,
            "key_exprs": key_exprs,
            "messages": messages,
        }

    everything = ["**", "**/@adv/**", "@ros2_lv/**"]
    return [
        rule("all", ["ingress", "egress"], everything, [*_ASKING, *_ANSWERING]),
        rule("read_in", ["ingress"], readable, _ASKING),
        rule("read_out", ["egress"], readable, _ANSWERING),
        rule("drive_in", ["ingress"], drivable, ["put"]),
        rule("drive_out", ["egress"], drivable, ["declare_subscriber"]),
        rule("work_in", ["ingress"], workable, _ANSWERING),
        rule("work_out", ["egress"], workable, _ASKING),
    ]


def guest(invitation: Invitation) -> dict[str, Any]:
    """Return the session of a guest on another machine; a client, for a peer would get nothing."""
    return links.merged(
        links.merged(links.BASE, links.only("tls")),
        {
            "mode": "client",
            "connect": {
                "endpoints": [f"tls/{invitation.address}"],
                "timeout_ms": 10000,
                "exit_on_failure": True,
            },
            "transport": {
                "link": {
                    "tx": {"batch_size": BATCH_BYTES},
                    "tls": {
                        "root_ca_certificate_base64": _base64(invitation.ca),
                        "connect_private_key_base64": _base64(invitation.key),
                        "connect_certificate_base64": _base64(invitation.certificate),
                        "enable_mtls": True,
                    },
                },
                "unicast": {"compression": {"enabled": True}},
            },
        },
    )


def lead(invitation: Invitation) -> dict[str, Any]:
    """Return what makes a router of another machine lead on to the robot, whether that is on yet or not."""
    transport = guest(invitation)["transport"]
    return {
        "connect": {
            "endpoints": [f"tls/{invitation.address}"],
            "timeout_ms": -1,  # the robot may be off yet, or begin anew
            "exit_on_failure": False,
        },
        "transport": {
            "link": {key: transport["link"][key] for key in ("tx", "tls")},
            "unicast": transport["unicast"],
        },
    }


def ros_router(invitation: Invitation) -> dict[str, Any]:
    """Return the configuration of a ROS 2 machine's own router, `rmw_zenohd`, that leads on to the robot.

    Its ROS nodes talk to it and to each other as they always do; what passes to and from the robot is what
    the guest's role allows. A session of each node by itself would do for a viewer, but the robot's hub
    carries nothing between two guests.
    """
    led = lead(invitation)
    return {
        "mode": "router",
        # Not on all addresses, as rmw_zenohd does by default: whoever reaches it has the guest's rights.
        "listen": {"endpoints": [ROS_ROUTER]},
        "connect": {
            **led["connect"],
            "retry": {"period_init_ms": 500, "period_max_ms": 4000, "period_increase_factor": 2},
        },
        "scouting": {"multicast": {"enabled": False}},
        # As in the configuration that rmw_zenoh ships: latched topics and slow services need them.
        "timestamping": {"enabled": True},
        "queries_default_timeout": 600_000,
        "transport": led["transport"],
    }


def visit(robot: str) -> dict[str, Any]:
    """Return the session of a command that looks at a robot: on this machine, or one that was paired with it.

    Raises:
        NotRunningError: It does not run here, and no invitation to it was kept.
    """
    if not rundir.is_running(robot) and (invitation := paired(robot)) is not None:
        return guest(invitation)
    return links.visitor(rundir.running(robot))


def is_guest(session: dict[str, Any]) -> bool:
    """Whether a session leads over a network."""
    return any(endpoint.startswith("tls/") for endpoint in session["connect"]["endpoints"])


def _base64(text: str) -> str:
    return base64.b64encode(text.encode()).decode()
