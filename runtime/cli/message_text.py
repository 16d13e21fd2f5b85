"""A message as YAML, the way `ros2 topic echo` shows it: a line for each value, long arrays cut short."""

import json
import math
from typing import Any

import numpy as np

from runtime import messages

LONG = 128
"""Elements of an array that are shown; a map has a million."""


def text_of(message: Any, longest: int = LONG) -> str:
    """Return a message as YAML; of an array only the first `longest` elements, and then `...`."""
    return "\n".join(_lines(message, longest))


def _lines(message: Any, longest: int) -> list[str]:
    lines: list[str] = []
    for name, _ in messages.TYPES.fielddefs[message.__msgtype__][1]:
        value = getattr(message, name)
        if hasattr(value, "__msgtype__"):
            lines += [f"{name}:", *(f"  {line}" for line in _lines(value, longest))]
        elif isinstance(value, list) and value and hasattr(value[0], "__msgtype__"):
            lines.append(f"{name}:")
            for one in value[:longest]:
                first, *rest = _lines(one, longest)
                lines += [f"- {first}", *(f"  {line}" for line in rest)]
            lines += ['- "..."'] * (len(value) > longest)
        else:
            lines.append(f"{name}: {_inline(value, longest)}")
    return lines


def _inline(value: Any, longest: int) -> str:
    if isinstance(value, np.ndarray | list):
        shown = value[:longest].tolist() if isinstance(value, np.ndarray) else value[:longest]
        cut = ["..."] * (len(value) > longest)
        return f"[{', '.join([*(_inline(one, longest) for one in shown), *cut])}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
    return str(value)
