"""What a person may have meant by a word that nobody knows."""

import difflib
from collections.abc import Iterable


def meant(word: object, known: Iterable[str]) -> str:
    """Return the known word that this one is like, as the end of a sentence; empty if there is none."""
    near = difflib.get_close_matches(str(word), list(known), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""
