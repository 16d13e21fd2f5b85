"""What is drawn where and in which colour: the only module that imports rerun.

Plain arrays in, all in the map frame, metres and radians. Nothing here knows topics or messages.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from runtime.nodes.viewing.words import STARTING

TIMELINE = "time"
BACKGROUND = 229
"""Grey of what is unknown, and of everything around the map."""

_PATH = (214, 40, 40)
_HITS = (38, 99, 214)
_RAYS = (150, 168, 190)
_PARTICLES = (140, 60, 170)
_ELLIPSE = (22, 135, 84)
_BLIND = (245, 140, 0)
_STATES = {
    STARTING: (120, 130, 140),
    "TRACKING": (22, 135, 84),
    "DEGENERATE": (245, 140, 0),
    "LOST": (214, 40, 40),
}
_BUMPS = {"free": (90, 100, 110), "bumped": (214, 40, 40), "wheel drop": (245, 140, 0)}
# Heights over the grid; closer together they flicker.
_Z_RAYS, _Z_PARTICLES, _Z_PATH, _Z_HITS, _Z_ELLIPSE, _Z_LASER = 0.05, 0.08, 0.11, 0.14, 0.17, 0.20
_PLOT_S = 120
_AGE_MS = 400.0
"""Height of the plot of ages: fixed, for one late pose would make the rest flat."""
_LEGEND = (
    "From above: red way, blue points of the match, pale other rays, purple particles, "
    "green 95 %, orange unseen direction"
)
_SERIES = {
    "latency/scan_to_pose": ("first ray to pose", _PATH),
    "latency/scan_to_map": ("last scan in it to map", _RAYS),
    "rate/scan": ("scans", _HITS),
    "rate/odom": ("matches", _ELLIPSE),
    "rate/pose": ("poses", _PATH),
    "base/battery": ("battery", _ELLIPSE),
}


class Screen:
    """One recording: sent to a viewer, or written to a file.

    Args:
        name: Of the robot, shown as the recording's name.
        fit: Whether the view moves away when the map outgrows it.
        told: Whether states, ages and rates are told, too; else there is no place for them.
    """

    def __init__(
        self,
        name: str,
        *,
        url: str | None = None,
        file: Path | None = None,
        fit: bool = True,
        told: bool = True,
    ) -> None:
        # 8 ms between drawing and sending; a file waits for 200 ms, and is smaller for it.
        batching = rr.ChunkBatcherConfig.LOW_LATENCY() if url is not None else None
        self._rec = rr.RecordingStream("hallway", send_properties=False, batcher_config=batching)
        self._fit, self._told = fit, told
        self._now = np.datetime64(0, "ns")
        self._shown_m: NDArray[np.float64] = np.array(((-6.0, -4.0), (6.0, 4.0)))
        if url is not None:
            self._rec.connect_grpc(url, default_blueprint=self._layout())
        if file is not None:
            self._rec.save(file)
            # A default is not enough: a viewer to which the file is sent would keep to a layout of its own.
            self._rec.send_blueprint(self._layout())
        self._rec.send_recording_name(name)
        self._rec.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for path, (label, colour) in _SERIES.items():
            self._rec.log(path, rr.SeriesLines(colors=colour, names=label, widths=1.5), static=True)
        for path, table in (("state/tracking", _STATES), ("state/bumper", _BUMPS)):
            known = rr.StateConfiguration(values=list(table), labels=list(table), colors=list(table.values()))
            self._rec.log(path, known, static=True)

    def at(self, stamp_ns: int) -> None:
        """Set the time of what is drawn next."""
        self._now = np.datetime64(stamp_ns, "ns")
        self._rec.set_time(TIMELINE, timestamp=self._now)

    def grid(self, cells: NDArray[np.int8], resolution_m: float, origin_m: tuple[float, float]) -> None:
        """Draw a map: (rows, cols) of -1 for unknown, 0 free .. 100 occupied; row 0 has the lowest y."""
        shade = np.where(cells < 0, BACKGROUND, 255 - cells.astype(np.int16) * 227 // 100).astype(np.uint8)
        form = rr.components.ImageFormat(
            width=cells.shape[1], height=cells.shape[0], color_model="L", channel_datatype="U8"
        )
        self._rec.log(
            "world/map",
            rr.GridMap(
                data=shade[::-1].tobytes(),  # rerun paints the first row on top
                format=form,
                cell_size=resolution_m,
                translation=[*origin_m, 0.0],
                colormap=rr.components.Colormap.Grayscale,
            ),
        )
        known = np.argwhere(cells >= 0)
        if len(known):
            low, high = known.min(axis=0)[::-1], known.max(axis=0)[::-1] + 1.0
            self._keep_in_view(np.array((low, high)) * resolution_m + np.asarray(origin_m))

    def scan(self, rays: NDArray[np.float64], hits: NDArray[np.float64]) -> None:
        """Draw one sweep: where its rays ended (N, 2), and the points that the match used (M, 2)."""
        self._points("world/scan/rays", rays, _Z_RAYS, _RAYS, 1.2)
        self._points("world/scan/used", hits, _Z_HITS, _HITS, 1.8)

    def laser(self, map_t_laser: NDArray[np.float64]) -> None:
        """Draw the laser (3,) as an arrow head."""
        x, y, yaw = map_t_laser
        outline = np.array(((0.35, 0.0), (-0.2, 0.2), (-0.1, 0.0), (-0.2, -0.2), (0.35, 0.0)))
        c, s = np.cos(yaw), np.sin(yaw)
        corners = outline @ np.array(((c, s), (-s, c))) + (x, y)
        self._strips("world/laser", [corners], _Z_LASER, _PATH, 2.5)

    def uncertainty(self, ellipse: NDArray[np.float64], blind: NDArray[np.float64]) -> None:
        """Draw an ellipse as a closed line (K, 2), and the ends (2, 2) or (0, 2) of the unseen direction."""
        self._strips("world/uncertainty", [ellipse], _Z_ELLIPSE, _ELLIPSE, 1.5)
        self._strips("world/blind", [blind] if len(blind) else [], _Z_ELLIPSE, _BLIND, 4.0)

    def path(self, points: NDArray[np.float64]) -> None:
        """Draw where the laser went, (N, 2)."""
        self._strips("world/trajectory", [points], _Z_PATH, _PATH, 1.5)

    def particles(self, poses: NDArray[np.float64]) -> None:
        """Draw the guesses of the filter, (P, 3), as short strokes."""
        ahead = poses[:, :2] + 0.15 * np.column_stack((np.cos(poses[:, 2]), np.sin(poses[:, 2])))
        strokes = list(np.stack((poses[:, :2], ahead), axis=1))
        self._strips("world/particles", strokes, _Z_PARTICLES, _PARTICLES, 1.0)

    def number(self, path: str, value: float) -> None:
        """Add a value to one of the plots."""
        self._rec.log(path, rr.Scalars(value))

    def state(self, path: str, word: str) -> None:
        """Add a word to a lane of the state plot."""
        self._rec.log(path, rr.StateChange(state=word))

    def words(self, markdown: str) -> None:
        """Set the text beside the map."""
        self._rec.log("state/words", rr.TextDocument(markdown, media_type="text/markdown"))

    def note(self, level: str, text: str) -> None:
        """Add an entry to the list of what happened, with its time of day as the plots have it."""
        # Not in rerun's own column of times: that has no room for more than the century of a date.
        _, _, time_of_day = str(self._now.astype("datetime64[s]")).partition("T")
        severity = {"ok": "INFO", "warn": "WARN"}.get(level, "ERROR")
        self._rec.log("log", rr.TextLog(f"{time_of_day} {text}", level=severity))

    def close(self, timeout_s: float) -> None:
        """Send or write what is held; give up after `timeout_s`."""
        try:
            self._rec.flush(timeout_sec=timeout_s)
        except (RuntimeError, ValueError):
            return  # the viewer has gone: nobody is left to be told
        self._rec.disconnect()

    def _points(
        self, path: str, points: NDArray[np.float64], z: float, colour: Sequence[int], size: float
    ) -> None:
        self._rec.log(path, rr.Points3D(_raised(points, z), colors=colour, radii=rr.Radius.ui_points(size)))

    def _strips(
        self, path: str, strips: list[NDArray[np.float64]], z: float, colour: Sequence[int], size: float
    ) -> None:
        raised = [_raised(strip, z) for strip in strips]
        self._rec.log(path, rr.LineStrips3D(raised, colors=colour, radii=rr.Radius.ui_points(size)))

    def _keep_in_view(self, known_m: NDArray[np.float64]) -> None:
        """Step back when what is known leaves the view; in big steps, because that undoes a person's zoom."""
        if not self._fit or ((known_m[0] >= self._shown_m[0]) & (known_m[1] <= self._shown_m[1])).all():
            return
        room = 0.1 * (known_m[1] - known_m[0]) + 0.7
        self._shown_m = np.array((known_m[0] - room, known_m[1] + room))
        self._rec.send_blueprint(self._layout())

    def _layout(self) -> Any:
        centre = self._shown_m.mean(axis=0)
        width, height = self._shown_m[1] - self._shown_m[0]
        # Rerun's eye opens 45 degrees vertically; the view is about 4 : 3.
        distance = max(width / 1.33, height) / 0.83
        eye = rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=[*centre, distance],
            look_target=[*centre, 0.0],
            eye_up=[0.0, 1.0, 0.0],
        )
        last = rrb.VisibleTimeRange(
            TIMELINE,
            start=rrb.TimeRangeBoundary.cursor_relative(seconds=-_PLOT_S),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
        legend = rrb.PlotLegend(rrb.Corner2D.LeftTop)
        plots = [
            rrb.TimeSeriesView(
                origin=origin,
                name=name,
                plot_legend=legend,
                time_ranges=[last],
                axis_y=rrb.ScalarAxis(range=reach) if reach else None,
            )
            for origin, name, reach in (
                ("/latency", "Age, ms", (0.0, _AGE_MS)),
                ("/rate", "Rate, Hz", None),
                ("/base", "Battery, %", (0.0, 100.0)),
            )
        ]
        columns = rrb.TextLogColumns(
            timeline_columns=[rrb.encodings.TimelineColumn(TIMELINE, visible=False)],
            text_log_columns=["loglevel", "body"],
        )
        lanes = ["/state/tracking", "/state/bumper"]
        words = rrb.TextDocumentView(origin="/state/words", name="State")
        side = rrb.Vertical(
            words,
            rrb.StateTimelineView(origin="/state", contents=lanes, name="States"),
            rrb.Tabs(*plots),
            rrb.TextLogView(origin="/log", name="What happened", columns=columns),
            row_shares=[8, 4.5, 5, 7.5],
        )
        grey = [BACKGROUND] * 3
        view = rrb.Spatial3DView(
            origin="/world", name=_LEGEND, background=grey, line_grid=False, eye_controls=eye
        )
        return rrb.Blueprint(
            rrb.Horizontal(side if self._told else words, view, column_shares=[2, 5]),
            rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
            rrb.SelectionPanel(state="hidden"),
            rrb.BlueprintPanel(state="hidden"),
            auto_views=False,
            auto_layout=False,
        )


def send_file(url: str, file: Path) -> None:
    """Send an .rrd file to a viewer."""
    rec = rr.RecordingStream("hallway", send_properties=False)
    rec.connect_grpc(url)
    rec.log_file_from_path(file)
    rec.flush(timeout_sec=60.0)
    rec.disconnect()


def _raised(points: NDArray[np.float64], z: float) -> NDArray[np.float32]:
    flat = np.full((len(points), 3), z, dtype=np.float32)
    flat[:, :2] = points[:, :2]
    return flat
