"""What a live node notes of each scan for the report: a table that grows line by line.

It is on disk, not in memory, and a process that was killed leaves what it had noted to the next one.
"""

from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.population import Population

MATCH_FILE, MATCH_COLUMNS = "match.csv", ("stamp_ns", "state", "score", "points", "best_mm", "worst_mm")
KEYS_FILE, KEYS_COLUMNS = "keys.csv", ("stamp_ns", "n_eff", "resampled")
PARTICLES_FILE = "particles.npz"


class Rows:
    """Appends rows to a CSV file; does nothing where no results are wanted.

    Args:
        results_dir: Of the node. The file is in the run's folder around it: the node's own is written in one
            step at the end.
        name: Of the file.
        columns: Their names.
    """

    def __init__(self, results_dir: Path | None, name: str, columns: tuple[str, ...]) -> None:
        self._file = None
        if results_dir is not None and results_dir.parent.is_dir():
            # Blocks of a few kilobytes reach the disk: a row a scan shall not wait for it each time.
            self._file = (results_dir.parent / name).open("a", encoding="ascii")
            if self._file.tell() == 0:
                self.add(*columns)

    def add(self, *values: object) -> None:
        """Append one row."""
        if self._file is not None:
            self._file.write(",".join(map(str, values)) + "\n")

    def __enter__(self) -> "Rows":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._file.close()


def ancestors_of(people: Population) -> NDArray[np.int16]:
    """Return which ancestor each particle had at each key scan, (P, K): equal numbers are the same one."""
    paths = np.stack([people.ancestry.path(particle) for particle in range(people.config.particles)])
    labels = np.zeros(paths.shape[:2], dtype=np.int16)
    for key in range(paths.shape[1]):
        places = paths[:, key, 0] + 1j * paths[:, key, 1]
        labels[:, key] = np.unique(places, return_inverse=True)[1]
    return labels


def write_particles(results_dir: Path, people: Population) -> None:
    """Write the particles of the end, (P, 3), and their ancestors, into the run's folder."""
    file = results_dir.parent / PARTICLES_FILE
    np.savez_compressed(file, particles=people.poses, ancestors=ancestors_of(people))
