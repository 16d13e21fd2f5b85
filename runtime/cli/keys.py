"""Say who may come from another machine: invite, pair, revoke."""

import argparse
import json
from pathlib import Path

from runtime.cli.parsing import read_address
from runtime.cli.which_robot import add_robot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    make = actions.add_parser("make", help="on the robot, once: its authority and the certificate of its hub")
    make.add_argument(
        "--host", action="append", default=[], metavar="H", help="a name or address it will have"
    )
    invite = actions.add_parser("invite", help="on the robot: a file that lets one guest in")
    invite.add_argument("guest", help="name of the guest")
    invite.add_argument(
        "--role", choices=("viewer", "operator", "machine"), default="viewer", help="default viewer"
    )
    invite.add_argument(
        "--address", type=read_address, metavar="HOST[:PORT]", help="of the robot (default its first address)"
    )
    invite.add_argument("--out", type=Path, metavar="FILE", help="default GUEST.invitation")
    revoke = actions.add_parser("revoke", help="on the robot: strike a guest off the list")
    revoke.add_argument("guest")
    actions.add_parser("list", help="on the robot: the guests and their roles")
    pair = actions.add_parser("pair", help="on the laptop: keep an invitation")
    pair.add_argument("file", type=Path)
    ros = actions.add_parser(
        "ros", help="on a machine with ROS 2: what leads its rmw_zenoh router to the robot"
    )
    ros.add_argument("file", type=Path, help="an invitation")
    ros.add_argument("--out", type=Path, metavar="FILE", help="default GUEST.json5")
    add_robot(parser, actions=actions.choices.values())


def run(args: argparse.Namespace) -> int:
    """Do what was asked; 2 where it cannot be."""
    from runtime.access import gate, keys
    from runtime.errors import ConfigError
    from runtime.graph import check_robot

    check_robot(args.robot, "--robot")
    if args.action == "make":
        made = keys.make(args.robot, args.host)
        print(f"{made.folder}: keys of robot {args.robot!r}; next: hallway keys invite GUEST")
    elif args.action == "invite":
        address = args.address or next(
            (a for a in keys.own_addresses() if not a.startswith(("127.", "::1"))), None
        )
        if address is None:
            raise ConfigError("this machine has no address that others reach; give one with --address")
        out = args.out or Path(f"{args.guest}.invitation")
        _make_room(out)  # before anybody is on the list
        invitation = keys.invite(args.robot, args.guest, args.role, address)
        try:
            keys.write_private(out, invitation.to_bytes())
        except ConfigError:
            keys.revoke(args.robot, args.guest)
            raise
        print(f"{out}: lets {args.guest} in as {args.role}, at {invitation.address}; it is secret")
        print(f"on the laptop: hallway keys pair {out.name}")
    elif args.action == "revoke":
        keys.revoke(args.robot, args.guest)
        print(f"{args.guest} is off the list, and out")
    elif args.action == "list":
        for guest, role in keys.authority(args.robot).roster().items():
            print(f"{guest:20} {role}")
    elif args.action == "ros":
        invitation = keys.Invitation.read(args.file)
        out = args.out or Path(f"{invitation.guest}.json5")
        _make_room(out)
        text = json.dumps(gate.ros_router(invitation), indent=2) + "\n"
        keys.write_private(out, text.encode())
        print(f"{out}: leads to robot {invitation.robot!r} as {invitation.role}; it is secret")
        print(f"here: ZENOH_ROUTER_CONFIG_URI={out.absolute()} ros2 run rmw_zenoh_cpp rmw_zenohd")
    else:
        invitation = keys.pair(args.file)
        print(f"robot {invitation.robot!r} at {invitation.address}: paired, as {invitation.role}")
    return 0


def _make_room(out: Path) -> None:
    """Make the folder of a file that is to be; raises ConfigError where there is one, or none can be."""
    from runtime.errors import ConfigError
    from runtime.reports.results import check_writable

    if out.exists():
        raise ConfigError(f"{out}: exists already")
    check_writable(out)
    out.parent.mkdir(parents=True, exist_ok=True)
