"""What `--json` prints."""

import json
from typing import Any


def print_json(value: Any) -> None:
    """Print one object in one line; JSON knows no NaN, which becomes null."""
    from runtime.reports.results import to_json

    print(json.dumps(json.loads(to_json(value))), flush=True)
