"""Two workers side by side (`pytest -n 2`): whole robots one by one, all other tests a file at a time."""

import os

import numba  # noqa: F401  so that no command that reads a configuration here loads the loops uncompiled
import pytest

from runtime.cli import patience
from runtime.cli.compiling import compile_all

ROBOTS = {
    f"test_{name}.py"
    for name in (
        "create_stop",
        "demo",
        "docs",
        "machines",
        "pages_walked",
        "paper_command",
        "remote",
        "remote_records",
        "replay_map",
        "replay_zenoh",
        "resume",
        "ros_client",
        "sessions",
        "simulator",
        "supervisor",
        "up",
        "view_command",
        "viewer",
    )
}
"""Files whose tests start many processes: two such at a time would be more than two cores carry."""


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """Keep the groups of `pytest_collection_modifyitems` together, in their order."""
    if getattr(config.option, "numprocesses", None):
        config.option.dist, config.option.loadscopereorder = "loadgroup", False


def pytest_configure(config: pytest.Config) -> None:
    """Compile the inner loops once, before two workers would both do it.

    Where tests share a machine everything may take long: that is no news here.
    """
    patience.LONG_S = 600.0
    if not hasattr(config, "workerinput") and getattr(config.option, "numprocesses", None):
        compile_all(os.environ, print)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the robots first and together, every other file by itself."""
    items.sort(key=lambda item: item.path.name not in ROBOTS)
    for item in items:
        name = item.path.name
        item.add_marker(pytest.mark.xdist_group("robots" if name in ROBOTS else name))
