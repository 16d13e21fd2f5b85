"""Maps as nav2's map_server and AMCL load them: `map.yaml` and a grey picture, trinary.

The picture's first row is the highest y; 0 is occupied, 254 free, 205 unknown.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.config import load_yaml
from runtime.formats.errors import FormatError

OCCUPIED, FREE, UNKNOWN = 0, 254, 205
OCCUPIED_THRESHOLD = 0.65
FREE_THRESHOLD = 0.25
"""Of the probabilities, as map_saver draws them."""
READ_FREE_THRESHOLD = 0.196
"""Of the picture, as map_server reads it: grey 205 means 0.19608 there, so with 0.25 the unknown would
load as free (SteveMacenski/slam_toolbox#587)."""


@dataclass(frozen=True, slots=True, eq=False)
class GridMap:
    """A grid of probabilities; row 0 has the lowest y."""

    probability: NDArray[np.float32]
    """(rows, cols) in [0, 1], NaN where unknown."""
    resolution_m: float
    origin_m: tuple[float, float]
    """Lower left corner of cell (0, 0), map frame."""


def trinary(probability: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the picture (rows, cols) of a grid; its first row is the highest y, the grid's is the lowest."""
    picture = np.full(probability.shape, UNKNOWN, dtype=np.uint8)
    picture[probability > np.float32(OCCUPIED_THRESHOLD)] = OCCUPIED
    picture[probability < np.float32(FREE_THRESHOLD)] = FREE
    return picture[::-1]


def pgm_bytes(picture: NDArray[np.uint8]) -> bytes:
    """Encode a grey picture (rows, cols) as binary PGM."""
    rows, cols = picture.shape
    return f"P5\n{cols} {rows}\n255\n".encode("ascii") + np.ascontiguousarray(picture).tobytes()


def map_yaml(image: str, grid: GridMap) -> str:
    """Return the description that stands beside the picture, with map_server's own keys."""
    x, y = grid.origin_m
    return (
        f"image: {image}\nmode: trinary\nresolution: {grid.resolution_m:.6g}\norigin: [{x:.6f}, {y:.6f}, 0]\n"
        f"negate: 0\noccupied_thresh: {OCCUPIED_THRESHOLD}\nfree_thresh: {READ_FREE_THRESHOLD}\n"
    )


def write_map(folder: Path, grid: GridMap, name: str = "map") -> None:
    """Write `name.pgm` and `name.yaml`; the same grid gives the same bytes."""
    (folder / f"{name}.pgm").write_bytes(pgm_bytes(trinary(grid.probability)))
    (folder / f"{name}.yaml").write_text(map_yaml(f"{name}.pgm", grid), encoding="ascii")


def write_keep_out(folder: Path, keep_out: NDArray[np.bool_], grid: GridMap, name: str = "keepout") -> None:
    """Write `name.pgm` and `name.yaml`: the mask of nav2's keep-out filter, of the same cells as the map.

    Served by a map_server of its own beside a costmap_filter_info_server of type 0, base 0 and multiplier 1;
    see nav2's "Navigating with Keepout Zones".

    Args:
        folder: Where.
        keep_out: (rows, cols) row 0 has the lowest y.
        grid: The map.
        name: Of both files, without ending.
    """
    picture = np.where(keep_out, OCCUPIED, FREE).astype(np.uint8)[::-1]
    (folder / f"{name}.pgm").write_bytes(pgm_bytes(picture))
    (folder / f"{name}.yaml").write_text(map_yaml(f"{name}.pgm", grid), encoding="ascii")


def read_map(path: Path) -> GridMap:
    """Load a map from its YAML as map_server does in trinary mode: occupied 1, free 0, unknown NaN.

    Raises:
        FormatError: A missing key, a turned origin, or a picture that is no binary PGM.
        ConfigError: The file is no YAML.
    """
    data = load_yaml(path)
    keys = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
    known = data if isinstance(data, dict) else {}
    if missing := [key for key in keys if key not in known]:
        raise FormatError(path, f"map_server keys missing: {', '.join(missing)}")
    if data.get("mode", "trinary") != "trinary":
        raise FormatError(path, f"mode = {data['mode']!r}, must be 'trinary'")
    origin = data["origin"]
    if len(origin) != 3 or origin[2] != 0:
        raise FormatError(path, f"origin = {origin}, must be [x, y, 0]")
    grey = _read_pgm(path.parent / data["image"])[::-1].astype(np.float64)
    occupancy = grey / 255.0 if data["negate"] else (255.0 - grey) / 255.0
    probability = np.full(grey.shape, np.nan, dtype=np.float32)
    probability[occupancy > data["occupied_thresh"]] = 1.0
    probability[occupancy < data["free_thresh"]] = 0.0
    return GridMap(probability, float(data["resolution"]), (float(origin[0]), float(origin[1])))


def _read_pgm(path: Path) -> NDArray[np.uint8]:
    data = path.read_bytes()
    fields: list[bytes] = []
    at = 0
    while len(fields) < 4:  # magic, width, height, maximum; '#' begins a comment
        end = at
        while end < len(data) and not data[end : end + 1].isspace():
            end += 1
        if end >= len(data):
            raise FormatError(path, "not a PGM picture: its header ends too early")
        if data[at : at + 1] == b"#":
            at = data.index(b"\n", at) + 1
            continue
        if end > at:
            fields.append(data[at:end])
        at = end + 1
    if fields[0] != b"P5" or not all(field.isdigit() for field in fields[1:]) or fields[3] != b"255":
        raise FormatError(path, f"header {b' '.join(fields)!r}, must be P5 width height 255")
    cols, rows = int(fields[1]), int(fields[2])
    if len(data) - at != rows * cols:
        raise FormatError(path, f"{len(data) - at} bytes of picture, must be {rows * cols}")
    return np.frombuffer(data, dtype=np.uint8, offset=at).reshape(rows, cols)
