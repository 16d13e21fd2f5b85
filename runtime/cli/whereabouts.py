"""What is said while a drive looks for itself on a saved map: once for each change, not for each look."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from processing.slam import Step


class Whereabouts:
    """Follows the steps of a drive that begins somewhere on a saved map.

    Args:
        say: Takes one line for people.
        period_s: Time from scan to scan.
    """

    def __init__(self, say: Callable[[str], None], period_s: float) -> None:
        self._say, self._period_s = say, period_s
        self._scans = 0
        self._equal = False
        self.found_s: float | None = None
        """Time from the first scan until it was found; None before."""
        self.refusals = 0
        """How often several places fitted equally, after one did or none."""
        self.lost = True
        """Whether the place is not known now."""

    def take(self, step: "Step") -> None:
        """Take the next step."""
        from runtime.nodes.saved import places_in_words

        mapping = step.mapping
        self._scans += 1
        at_s = (self._scans - 1) * self._period_s
        equal = mapping.lost and len(mapping.places) > 1
        if equal and not self._equal:
            self.refusals += 1
            if self.refusals <= 3:
                places = places_in_words(mapping.places)
                self._say(f"{at_s:.1f} s: {len(mapping.places)} places fit equally: {places}; looking on")
        self._equal, self.lost = equal, mapping.lost
        if not mapping.lost and self.found_s is None:
            self.found_s = at_s
            self._say(f"{at_s:.1f} s: found on the saved map at {places_in_words((mapping.map_t_laser,))}")

    def report(self) -> dict[str, Any]:
        """Return figures for machines."""
        return {"found_s": self.found_s, "equal_places": self.refusals}
