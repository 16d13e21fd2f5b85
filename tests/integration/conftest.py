"""Fixtures of more than one file."""

from tests.integration.remote.stage import namespaces, robot  # noqa: F401
from tests.integration.supervised import scene  # noqa: F401
