"""How a verb is told which robot it is for: in the same words everywhere, before its action or behind it."""

import argparse
from collections.abc import Iterable

from runtime.cli.parsing import whole_number

ROBOT = "robot"
DOMAIN = whole_number(0, 232)
"""Reads the number of a ROS domain."""


def add_robot(
    parser: argparse.ArgumentParser, *, domain: bool = False, actions: Iterable[argparse.ArgumentParser] = ()
) -> None:
    """Declare --robot, and with `domain` --domain.

    Args:
        parser: Of the verb.
        domain: Whether the verb asks for the ROS domain, too.
        actions: Parsers of the verb's actions: people write the robot behind those as well.
    """
    _declare(parser, domain, robot=ROBOT, number=0)
    for action in actions:
        # Who says nothing behind the action has not taken back what was said before it.
        _declare(action, domain, robot=argparse.SUPPRESS, number=argparse.SUPPRESS)


def _declare(parser: argparse.ArgumentParser, domain: bool, *, robot: str, number: int | str) -> None:
    parser.add_argument("--robot", default=robot, metavar="NAME", help=f"which robot (default {ROBOT})")
    if domain:
        parser.add_argument(
            "--domain", type=DOMAIN, default=number, metavar="N", help="ROS domain (default 0)"
        )
