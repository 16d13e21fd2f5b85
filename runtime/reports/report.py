"""One file about one run, to read and to attach to a bug report: map, match along the way, settings.

A page without scripts or links, made of plain arrays; the same arrays give the same bytes.
"""

import base64
import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.reports import chart
from runtime.reports.tables import facts_table, latency_table

STATES = ("TRACKING", "DEGENERATE", "LOST")
DOUBTED = "doubted"
"""What tracks on, while scans contradict the map or did so a moment ago."""
DOUBTED_M = 0.05
"""Where each direction is known no better than this, the matcher doubts (`processing.odometry.SHAKEN`)."""
_COLOURS = {"TRACKING": "#16875480", DOUBTED: "#7048b8", "DEGENERATE": "#f58c00", "LOST": "#d62828"}
_LATE_STRETCHES = 12
TREE_KEYS = 300
"""So many key scans of the family tree are drawn at most, the newest ones."""

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1c2430; background: #fff;
       max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; margin: 0 0 .2rem } h2 { font-size: 1.15rem; margin: 2rem 0 .3rem }
p, li { max-width: 46rem } .quiet { color: #5a6470 }
img, svg { max-width: 100%; height: auto; display: block }
img { border: 1px solid #d8dce0 } pre { background: #f4f5f7; padding: .8rem; overflow-x: auto;
      font-size: 13px }
table { border-collapse: collapse }
td, th { padding: .15rem .9rem .15rem 0; text-align: left; vertical-align: top }
.facts td + td { overflow-wrap: anywhere }
.numbers td:nth-child(n+2):nth-child(-n+4), .numbers th:nth-child(n+2) { text-align: right;
      font-variant-numeric: tabular-nums }
@media (max-width: 40rem) { .wide { overflow-x: auto }
      .wide svg[width="960"] { max-width: none; width: 40rem } }
"""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ReportData:
    """What a run has to tell; all arrays along the scans have the same length N."""

    title: str
    """Name of the log or of the robot."""
    picture: bytes
    """The map, PNG, as `map.png` has it."""
    known_m2: float | None = None
    """Area that was seen, where it was counted."""
    stamps_ns: NDArray[np.int64]
    """(N,) in the order of the scans."""
    map_t_laser: NDArray[np.float64]
    """(N, 3)."""
    states: Sequence[str] | None = None
    """N words of STATES; None where nobody noted them."""
    score: NDArray[np.float64] | None = None
    """(N,) quality of the match, 0 .. 1."""
    points: NDArray[np.int64] | None = None
    """(N,) points that the match used."""
    sigma_m: NDArray[np.float64] | None = None
    """(N, 2) least and greatest standard deviation of the motion since the last scan, m; NaN where it says
    nothing: lost, doubted, or beginning anew."""
    n_eff: NDArray[np.float64] | None = None
    """(N,) particles that share the weight."""
    resampled: NDArray[np.bool_] | None = None
    """(N,) whether particles were selected."""
    particles: NDArray[np.float64] | None = None
    """(P, 3) at the end."""
    ancestors: NDArray[np.int16] | None = None
    """(P, K) which ancestor each of the last particles had at each key scan; equal numbers are the same."""
    latency_ms: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """p50, p99, max for each hop of a live run."""
    counts: Mapping[str, Any] = field(default_factory=dict)
    """What was lost, refused or late, by name."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """Version, seed, host, input: what is needed to make the run again."""
    notices: Sequence[str] = ()
    """What the reader of the log had to say."""
    config: str = ""
    """The resolved configuration, YAML."""

    def __post_init__(self) -> None:
        count = len(self.stamps_ns)
        along = ("map_t_laser", "states", "score", "points", "sigma_m", "n_eff", "resampled")
        for name in along:
            value = getattr(self, name)
            if value is not None and len(value) != count:
                raise ValueError(f"{name} has {len(value)} entries, must have {count} as stamps_ns")


def write_report(path: Path, run: ReportData) -> None:
    """Write the page; in one step, so that a reader never finds half of it."""
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(page(run), encoding="utf-8")
    partial.replace(path)


def page(run: ReportData) -> str:
    """Return the whole page."""
    elapsed_s = _elapsed_s(run.stamps_ns)
    title = html.escape(run.title)
    parts = [f"<h1>{title}</h1>", f'<p class="quiet">{html.escape(_summary(run, elapsed_s))}</p>']
    parts += [_list(run.notices)] if run.notices else []
    parts += [_map(run)]
    if len(run.stamps_ns) > 1:
        parts += [_match(run, elapsed_s), _particles(run, elapsed_s)]
    parts += [latency_table(run.latency_ms)]
    parts += [facts_table("Counted", run.counts), facts_table("The run", run.facts)]
    if run.config:
        parts.append(f"<h2>Configuration</h2><pre>{html.escape(run.config)}</pre>")
    body = "\n".join(part for part in parts if part)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{title}</title>'
        f"<style>{_STYLE}</style></head><body>\n{body}\n</body></html>\n"
    )


def _elapsed_s(stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return seconds since the first scan, (N,); where stamps go backwards time stands still."""
    if len(stamps_ns) == 0:
        return np.zeros(0)
    return np.asarray(np.maximum.accumulate((stamps_ns - stamps_ns[0]) / 1e9))


def _summary(run: ReportData, elapsed_s: NDArray[np.float64]) -> str:
    if len(elapsed_s) == 0:
        return "No scan."
    steps = np.diff(run.map_t_laser[:, :2], axis=0)
    way_m = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
    known = "" if run.known_m2 is None else f", {run.known_m2:.0f} m² mapped"
    words = judged(run)
    shares = [
        f"{100.0 * share:.1f} % {word}"
        for word in _COLOURS
        if len(words) and (share := np.count_nonzero(words == word) / len(words)) > 0
    ]
    return (
        f"{len(elapsed_s)} scans in {elapsed_s[-1]:.0f} s, {way_m:.1f} m driven{known}"
        f"{'; ' if shares else ''}{', '.join(shares)}"
    )


def _map(run: ReportData) -> str:
    data = base64.b64encode(run.picture).decode()
    alt = "Map from above: walls dark, free ground white, the way of the laser red"
    return f'<h2>Map</h2><img alt="{alt}" src="data:image/png;base64,{data}">'


def _match(run: ReportData, elapsed_s: NDArray[np.float64]) -> str:
    parts = []
    if run.states is not None:
        words = judged(run)
        parts += [
            "<p>Green: the scan fits in every direction. Purple, doubted: a scan contradicts the map, or did "
            f"so a moment ago, as when somebody walks past; each motion may be {1e2 * DOUBTED_M:.0f} cm off. "
            "Orange: one direction is not seen, as in a long corridor. Red: the scan fits nowhere.</p>",
            chart.strip(elapsed_s, words, _COLOURS),
            _stretches(run.map_t_laser, words, elapsed_s),
        ]
    if run.score is not None:
        # The first scan had nothing to be matched with.
        score = np.r_[np.nan, run.score[1:]]
        parts.append(
            chart.lines(elapsed_s, {"score": score}, "score of the match, 0 to 1", low=0.0, high=1.0)
        )
    if run.sigma_m is not None:
        millimetres = {"worst direction": 1e3 * run.sigma_m[:, 1], "best direction": 1e3 * run.sigma_m[:, 0]}
        title = "how well each motion is known: one standard deviation, mm, on a logarithmic scale"
        parts.append(chart.decades(elapsed_s, millimetres, title))
    if run.points is not None:
        parts.append(chart.lines(elapsed_s, {"points": run.points}, "points used by the match", low=0.0))
    return _section("The match along the way", parts)


def judged(run: ReportData) -> NDArray[np.str_]:
    """Return each scan's state, (N,), or DOUBTED where the track went on in doubt; (0,) if nobody noted them.

    A scan that tells nothing although it tracks is a doubted one, unless the track begins with it.
    """
    states = np.array(run.states if run.states is not None else (), dtype="<U10")
    if run.sigma_m is None or not len(states):
        return states
    best_m = run.sigma_m[:, 0]
    begins = np.r_[True, states[:-1] == "LOST"]
    unsure = (best_m >= DOUBTED_M) | (np.isnan(best_m) & ~begins)
    return np.where(unsure & (states == "TRACKING"), DOUBTED, states)


def _stretches(
    map_t_laser: NDArray[np.float64], states: NDArray[np.str_], elapsed_s: NDArray[np.float64]
) -> str:
    """List where the match did not hold, the longest first."""
    bad = [(begin, end) for begin, end in chart.spells(states) if states[begin] != STATES[0]]
    bad.sort(key=lambda be: elapsed_s[be[0]] - elapsed_s[be[1]])
    lines = []
    for begin, end in bad[:_LATE_STRETCHES]:
        x, y, _ = np.round(map_t_laser[begin], 1) + 0.0  # no minus before a zero
        lines.append(
            f"{states[begin]} from {elapsed_s[begin]:.1f} to {elapsed_s[end]:.1f} s, at ({x:.1f}, {y:.1f}) m"
        )
    if len(bad) > _LATE_STRETCHES:
        lines.append(f"and {len(bad) - _LATE_STRETCHES} shorter ones")
    return _list(lines) if lines else ""


def _particles(run: ReportData, elapsed_s: NDArray[np.float64]) -> str:
    parts = []
    if run.n_eff is not None:
        parts.append(
            "<p>Each particle is a way that the laser may have come, with a map of its own. On new ground "
            "all of them weigh the same; on old ground those weigh more whose maps the scans fit.</p>"
        )
        title = "particles that share the weight"
        if run.resampled is not None:
            title += f"; selected {int(np.count_nonzero(run.resampled))} times"
        parts.append(chart.lines(elapsed_s, {"effective particles": run.n_eff}, title, low=0.0))
    if run.ancestors is not None and run.ancestors.shape[1] > 1:
        many = 1 + (np.diff(np.sort(run.ancestors, axis=0), axis=0) != 0).sum(axis=0)
        keys = np.arange(len(many), dtype=np.float64)
        title = "different ancestors of the last particles, by key scan: where it is one, the past is settled"
        parts.append(chart.lines(keys, {"ancestors": many}, title, low=0.0, unit=""))
        alone = np.flatnonzero(many == 1)
        since = int(alone[-1]) if len(alone) else 0
        title = f"their family tree since key scan {since}, the last at which all had one ancestor"
        title = title if len(alone) else "their family tree"
        parts.append(chart.tree(run.ancestors[:, max(since, len(many) - TREE_KEYS) :], title))
    if run.particles is not None and len(run.particles):
        parts.append(chart.cloud(run.particles, "the last particles, from above"))
    return _section("Particles", parts)


def _section(title: str, parts: Sequence[str]) -> str:
    """Return charts under a heading; where the page is narrow they move sideways together."""
    return "\n".join([f'<h2>{title}</h2><div class="wide">', *parts, "</div>"]) if parts else ""


def _list(lines: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{html.escape(line)}</li>" for line in lines) + "</ul>"
