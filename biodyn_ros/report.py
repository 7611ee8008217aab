"""Reports: one HTML file with its drawings inside; here that of a replay, and the traces it draws.

jinja2 and matplotlib come late: whoever wants no report needs neither.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.errors import InputError
from biodyn_core.limits import HORIZONTAL_FACTOR
from biodyn_core.pipeline import HEAD, Frames
from biodyn_core.segments import N_SEGMENTS, N_SENSORS, SEAT, SEGMENTS, SENSORS
from biodyn_ros.resources import package_directory

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

ENVELOPE_BIN_NS: Final = 100_000_000
ENVELOPE_BINS: Final = 800
"""As many bins as a page can show; a longer record doubles their width."""

EVENT_HALF_NS: Final = 1_000_000_000
DIGEST_SAMPLES: Final = 4096
"""Frames are digested in batches of so many instants, because a block alone is too short. No figure depends on it."""

RECENT_SAMPLES: Final = 1 << 16
"""Predictions wait for their measurement no longer than this: 16 s at the highest rate, more than a pipeline waits."""

EVENT_SENSORS: Final = (SENSORS.index(SEAT), SENSORS.index(HEAD))


# --- traces ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Envelope:
    """Smallest and largest value per bin.

    begins_ns (m,) ascending, low_mps2 and high_mps2 (m, 6), NaN where a channel gave nothing.
    """

    width_ns: int
    begins_ns: Integers
    low_mps2: Floats
    high_mps2: Floats


@dataclass(frozen=True)
class Event:
    """Full-rate samples around the largest measured |acceleration| of seat or head: `peak_mps2`, at `peak_ns`.

    predicted_mps2 (n, 6) by segment at predicted_ns (n,), measured_mps2 (m, 6) by sensor at measured_ns (m,).
    """

    sensor: str
    peak_ns: int
    peak_mps2: float
    predicted_ns: Integers
    predicted_mps2: Floats
    measured_ns: Integers
    measured_mps2: Floats


class Traces:
    """Keeps what the replay report draws, in memory that does not grow with the bag: `add` every push's frames.

    The envelope has bins of 0.1 s, aligned to whole tenths of a second of stamp time; beyond ENVELOPE_BINS of them
    neighbours join and the width doubles. The event is EVENT_HALF_NS long on either side of the strongest instant.
    Cutting the frames differently changes nothing.
    """

    def __init__(self) -> None:
        self._predicted = _Stream(N_SEGMENTS)
        self._measured = _Stream(N_SENSORS)
        self._event: Event | None = None
        self._event_open = False

    def add(self, frames: Frames) -> None:
        """Take one push's frames; they must not be written to afterwards."""
        self._predicted.add(frames.predicted.stamps_ns, frames.predicted.accel_mps2)
        self._measured.add(frames.measured.stamps_ns, frames.measured.accel_mps2)
        if self._predicted.waiting + self._measured.waiting >= DIGEST_SAMPLES:
            self._digest()

    def predicted(self) -> Envelope:
        """The envelope of the six segments' predictions."""
        self._digest()
        return self._predicted.envelope

    def measured(self) -> Envelope:
        """The envelope of the six sensors' measurements."""
        self._digest()
        return self._measured.envelope

    def event(self) -> Event | None:
        """What surrounds the strongest instant; None where seat and head gave no number."""
        self._digest()
        return self._event

    @property
    def stored_samples(self) -> int:
        """Rows held right now: instants and bins."""
        event = 0 if self._event is None else self._event.predicted_ns.size + self._event.measured_ns.size
        return self._predicted.stored + self._measured.stored + event

    def _digest(self) -> None:
        # A prediction comes before the measurement of its instant, so it is there when the event closes.
        self._predicted.digest()
        stamps_ns, accel_mps2 = self._measured.digest()
        if stamps_ns.size == 0:
            return
        self._look_for_event(stamps_ns, accel_mps2)
        last_ns = int(stamps_ns[-1])
        if self._event is not None and self._event_open:
            self._event = self._around(self._event)
            self._event_open = abs(last_ns - self._event.peak_ns) < EVENT_HALF_NS
        for stream in (self._predicted, self._measured):
            stream.forget_before(last_ns - 2 * EVENT_HALF_NS)

    def _look_for_event(self, stamps_ns: Integers, accel_mps2: Floats) -> None:
        felt = np.abs(accel_mps2[:, EVENT_SENSORS])
        felt[np.isnan(felt)] = -1.0
        row, column = divmod(int(felt.argmax()), len(EVENT_SENSORS))
        peak = float(felt[row, column])
        if peak > (-1.0 if self._event is None else self._event.peak_mps2):
            nothing = np.empty(0, dtype=np.int64), np.empty((0, N_SEGMENTS))
            self._event = Event(SENSORS[EVENT_SENSORS[column]], int(stamps_ns[row]), peak, *nothing, *nothing)
            self._event_open = True

    def _around(self, event: Event) -> Event:
        begin, end = event.peak_ns - EVENT_HALF_NS, event.peak_ns + EVENT_HALF_NS
        predicted, measured = self._predicted.between(begin, end), self._measured.between(begin, end)
        return Event(event.sensor, event.peak_ns, event.peak_mps2, *predicted, *measured)


class _Stream:
    """One stream of six channels: what waits to be digested, what came of late, and the envelope of everything."""

    def __init__(self, channels: int) -> None:
        self._stamps_ns: list[Integers] = []
        self._accel_mps2: list[Floats] = []
        self._recent: tuple[Integers, Floats] = np.empty(0, dtype=np.int64), np.empty((0, channels))
        self.waiting = 0
        none = np.empty((0, channels))
        self.envelope = Envelope(ENVELOPE_BIN_NS, np.empty(0, dtype=np.int64), none, none)

    @property
    def stored(self) -> int:
        return self.waiting + self._recent[0].size + self.envelope.begins_ns.size

    def add(self, stamps_ns: Integers, accel_mps2: Floats) -> None:
        if stamps_ns.size:
            self._stamps_ns.append(stamps_ns)
            self._accel_mps2.append(accel_mps2)
            self.waiting += stamps_ns.size

    def digest(self) -> tuple[Integers, Floats]:
        """Take what waits into envelope and recent rows, and return it."""
        if not self.waiting:
            return self._recent[0][:0], self._recent[1][:0]
        stamps_ns, accel_mps2 = np.concatenate(self._stamps_ns), np.concatenate(self._accel_mps2)
        self._stamps_ns, self._accel_mps2, self.waiting = [], [], 0
        self.envelope = _widened(self.envelope, stamps_ns, accel_mps2)
        old_ns, old = self._recent
        recent_ns, recent = np.concatenate([old_ns, stamps_ns]), np.concatenate([old, accel_mps2])
        self._recent = recent_ns[-RECENT_SAMPLES:], recent[-RECENT_SAMPLES:]
        return stamps_ns, accel_mps2

    def between(self, begin_ns: int, end_ns: int) -> tuple[Integers, Floats]:
        stamps_ns, accel_mps2 = self._recent
        here = (stamps_ns >= begin_ns) & (stamps_ns <= end_ns)
        return stamps_ns[here], accel_mps2[here]

    def forget_before(self, begin_ns: int) -> None:
        stamps_ns, accel_mps2 = self._recent
        keep = stamps_ns >= begin_ns
        if not keep.all():
            self._recent = stamps_ns[keep], accel_mps2[keep]


def _widened(envelope: Envelope, stamps_ns: Integers, accel_mps2: Floats) -> Envelope:
    """The envelope with more samples in it, its bins doubled until there are few enough."""
    width = envelope.width_ns
    begins, low, high = _binned(stamps_ns, accel_mps2, accel_mps2, width)
    begins, low, high = (np.concatenate(p) for p in zip(_columns(envelope), (begins, low, high), strict=True))
    begins, low, high = _binned(begins, low, high, width)
    while begins.size > ENVELOPE_BINS:
        width *= 2
        begins, low, high = _binned(begins, low, high, width)
    return Envelope(width, begins, low, high)


def _columns(envelope: Envelope) -> tuple[Integers, Floats, Floats]:
    return envelope.begins_ns, envelope.low_mps2, envelope.high_mps2


def _binned(stamps_ns: Integers, low: Floats, high: Floats, width_ns: int) -> tuple[Integers, Floats, Floats]:
    """Join the rows of each bin: begins_ns (m,) ascending, smallest of `low` and largest of `high`, each (m, 6)."""
    bins = stamps_ns // width_ns
    if np.any(bins[1:] < bins[:-1]):  # stamps may jump back, as those of a looped bag do
        order = np.argsort(bins, kind="stable")
        bins, low, high = bins[order], low[order], high[order]
    first = np.flatnonzero(np.concatenate([[True], bins[1:] != bins[:-1]]))
    return bins[first] * width_ns, np.fmin.reduceat(low, first, axis=0), np.fmax.reduceat(high, first, axis=0)


# --- the replay's report ---------------------------------------------------------------------------------------------


def write_replay_report(path: Path, document: dict[str, Any], traces: Traces) -> None:
    """Write the page of a replay from the mapping of `exposure.json` and the traces of its frames.

    Raises InputError where jinja2 or matplotlib is missing, or the file cannot be written; then nothing is left of it.
    """
    check_reports()
    event, predicted, measured = traces.event(), traces.predicted(), traces.measured()
    origin_ns = min((int(e.begins_ns[0]) for e in (predicted, measured) if e.begins_ns.size), default=0)
    html = _render(
        "replay.html.j2",
        document=document,
        verdict=judge(document),
        segments=[name for name in SEGMENTS if name in document["predicted"]],
        sensors=[name for name in SENSORS if name in document["sensors"]],
        worst=_worst_residual(document),
        seat_axes=_seat_axes(document["seat"]),
        vdv_axis=_vdv_axis(document["seat"]),
        event=event,
        event_s=1e-9 * (event.peak_ns - origin_ns) if event else None,
        bin_s=1e-9 * max(predicted.width_ns, measured.width_ns),
        overlay_svg=_overlay(event, origin_ns, document) if event else None,
        envelope_svg=_envelopes(predicted, measured, event, origin_ns) if measured.begins_ns.size else None,
    )
    _write_beside(path, html)


def check_reports() -> None:
    """Raise InputError where a report could not be drawn, so that a long replay can say so before it begins."""
    for name in ("jinja2", "matplotlib"):
        try:
            __import__(name)
        except ImportError:
            raise InputError(f"reports need {name}: pip install 'biodyn_ros[reports]'") from None


@dataclass(frozen=True)
class Verdict:
    """The seat against its limits: tone (good, warn, bad or none), headline, and the reasons, a sentence each."""

    tone: str
    headline: str
    reasons: tuple[str, ...]


def judge(document: dict[str, Any]) -> Verdict:
    """Say how the seat stands against action and limit values; good only for complete data of all three axes."""
    seat, limits = document["seat"], document["limits"]
    if seat is None:
        return Verdict("none", "No verdict: nothing counted at the seat", ())
    reached = {
        kind: seat["a8_so_far_mps2"] >= limits[f"{kind}_a8_mps2"]
        or seat["vdv_so_far_mps175"] >= limits[f"{kind}_vdv_mps175"]
        for kind in ("action", "limit")
    }
    if reached["limit"]:
        tone, headline = "bad", "Limit value reached"
    elif reached["action"]:
        tone, headline = "warn", "Action value reached"
    elif seat["lower_bound"]:
        tone, headline = "none", "No verdict: the seat's figures are lower bounds"
    elif seat["horizontal"] == "missing":
        tone, headline = "none", "No verdict: vertical only"
    else:
        tone, headline = "good", "Below the action values so far"
    times = [_time_left(kind, at, seat) for kind, at in reached.items()]
    return Verdict(tone, headline, (*_bound_reasons(document), _HORIZONTAL[seat["horizontal"]], *times))


_HORIZONTAL: Final = {
    "yaw_given": "Horizontal axes from the yaw given.",
    "worst_direction": "No yaw given: the largest value over all horizontal directions stands for both axes.",
    "missing": "Vertical only: horizontal data are missing.",
}


def _bound_reasons(document: dict[str, Any]) -> list[str]:
    if not document["seat"]["lower_bound"]:
        return []
    seat = document["sensors"].get(SEAT, {})
    missing, clipped = seat.get("missing_s", 0.0), seat.get("clipped_samples", 0)
    return [f"At least so much: {missing:.3f} s are missing and {clipped} samples are clipped at the seat."]


def _time_left(kind: str, reached: bool, seat: dict[str, Any]) -> str:
    name, seconds = f"{kind.capitalize()} value", seat[f"time_to_{kind}_value_s"]
    if reached:  # a lower bound is enough to know that
        return f"{name}: reached."
    if seconds is None:
        withheld = "samples are clipped or more than 1 % is missing" if seat["lower_bound"] else "nothing was felt"
        return f"{name}: time left withheld, because {withheld}."
    most = "at most " if seat["lower_bound"] else ""
    return f"{name}: {most}{duration(seconds)} left, if exposure goes on as in this recording."


def _seat_axes(seat: dict[str, Any] | None) -> list[tuple[str, float, float, float]]:
    """Axis, factor k, aw and VDV without it, for every axis known."""
    if seat is None:
        return []
    aw, vdv = seat["aw_weighted_mps2"], seat["vdv_weighted_mps175"]
    return [(axis, 1.0 if axis == "z" else HORIZONTAL_FACTOR, aw[axis], vdv[axis]) for axis in aw]


def _vdv_axis(seat: dict[str, Any] | None) -> str | None:
    """The axis whose VDV is largest; the document's `axis` is that of aw."""
    return max(_seat_axes(seat), key=lambda row: row[1] * row[3])[0] if seat else None


def _worst_residual(document: dict[str, Any]) -> tuple[str, float] | None:
    shares = {name: residual["nrmse_rms_percent"] for name, residual in document["residual"].items()}
    known = {name: share for name, share in shares.items() if share is not None}
    worst = max(known, key=lambda name: known[name], default=None)
    return (worst, known[worst]) if worst else None


# --- words and numbers -----------------------------------------------------------------------------------------------


def number(value: float | None) -> str:
    """Three significant digits without an exponent where that is possible; a dash for what is not known."""
    if value is None or math.isnan(value):
        return "–"
    size = abs(value)
    if size == 0.0 or not 1e-3 <= size < 1e6:
        return f"{value:.3g}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(size)))}f}"


def bound(value: float | None, lower: bool) -> str:
    """The number, with ">=" before it where it is a lower bound."""
    return f">= {number(value)}" if lower and value is not None else number(value)


def duration(seconds: float) -> str:
    """A time for people: 8.4 s, 12 min, 3 h 20 min, more than 24 h."""
    if seconds < 59.5:
        return f"{seconds:.3g} s"
    if seconds > 24.0 * 3600.0:
        return "more than 24 h"
    minutes = round(seconds / 60.0)
    if minutes < 60:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60} min"


def words(name: str) -> str:
    """A name of ours as words: `lower_torso` is "lower torso"."""
    return name.replace("_", " ")


# --- page ------------------------------------------------------------------------------------------------------------


def _render(template: str, **values: Any) -> str:
    import jinja2

    # Autoescape by name would miss templates that end in .j2.
    page = jinja2.Environment(
        loader=jinja2.FileSystemLoader(package_directory("templates")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page.filters.update(number=number, bound=bound, duration=duration, words=words)
    return page.get_template(template).render(**values)


def _write_beside(path: Path, text: str) -> None:
    """Write a file under another name and rename it, so that it is never half there."""
    part = path.with_name(f".{path.name}.part")
    try:
        # A file name that is not UTF-8 comes as lone surrogates; the page shows them as escapes.
        part.write_text(text, encoding="utf-8", errors="backslashreplace")
        part.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
    finally:
        part.unlink(missing_ok=True)


# --- drawings --------------------------------------------------------------------------------------------------------

MEASURED_COLOUR: Final = "#1f2933"
PREDICTED_COLOUR: Final = "#d9480f"
BAND_COLOUR: Final = "#a9b5c0"

_STYLE: Final[Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": "#8894a0",
    "axes.grid": True,
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 9.0,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8.0,
    "grid.color": "#e3e8ec",
    "grid.linewidth": 0.6,
    "svg.fonttype": "none",
    "svg.hashsalt": "biodyn",
    "xtick.color": "#52606d",
    "ytick.color": "#52606d",
}

_PANELS: Final = (*reversed(SEGMENTS), SEAT)
"""Two columns from the head down, the seat below everything, over the whole width."""


def _overlay(event: Event, origin_ns: int, document: dict[str, Any]) -> Any:
    """Measured and predicted at full rate around the strongest event, a panel per segment and one for the seat."""

    def draw(axes: Any, name: str) -> None:
        measured = event.measured_mps2[:, SENSORS.index(name)] if name in SENSORS else None
        predicted = event.predicted_mps2[:, SEGMENTS.index(name)] if name in SEGMENTS else None
        extent = _extent(measured, predicted)
        if measured is not None:
            axes.plot(*_line(event.measured_ns, measured, origin_ns), color=MEASURED_COLOUR, lw=1.7)
        if predicted is not None:
            clipped = np.clip(predicted, -10.0 * extent, 10.0 * extent)
            axes.plot(*_line(event.predicted_ns, clipped, origin_ns), color=PREDICTED_COLOUR, lw=0.9)
        axes.set_ylim(-extent, extent)
        axes.set_title(_note(name, measured, document), loc="right", color="#52606d", fontsize=8.0)

    return _draw(draw, 7.4, _seconds(event.measured_ns, origin_ns))


def _envelopes(predicted: Envelope, measured: Envelope, event: Event | None, origin_ns: int) -> Any:
    """Smallest and largest value per bin over the whole record."""

    def draw(axes: Any, name: str) -> None:
        there = _steps(measured, SENSORS.index(name), origin_ns) if name in SENSORS else None
        model = _steps(predicted, SEGMENTS.index(name), origin_ns) if name in SEGMENTS else None
        extent = _extent(np.stack(there[1:]) if there else None, np.stack(model[1:]) if model else None)
        if there:
            axes.fill_between(*there, color=BAND_COLOUR, lw=0.3)
        if model:
            for edge in model[1:]:
                axes.plot(model[0], np.clip(edge, -10.0 * extent, 10.0 * extent), color=PREDICTED_COLOUR, lw=0.7)
        axes.set_ylim(-extent, extent)
        if event is not None:
            axes.axvline(1e-9 * (event.peak_ns - origin_ns), color="#52606d", lw=0.6, ls=(0, (2, 2)))

    ends_ns = np.append(measured.begins_ns, measured.begins_ns[-1] + measured.width_ns)
    return _draw(draw, 6.2, _seconds(ends_ns, origin_ns))


def _draw(draw: Callable[[Any, str], None], height_in: float, times_s: Floats) -> Any:
    """Lay out the panels over the span of times_s, let `draw(axes, name)` fill each, and return the markup."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context():
        mpl.rcdefaults()  # the user's own style is for the user's own figures
        mpl.rcParams.update(_STYLE)
        figure = Figure(figsize=(10.4, height_in), layout="constrained")
        grid = figure.add_gridspec(4, 2)
        for place, name in enumerate(_PANELS):
            axes = figure.add_subplot(grid[3, :] if name == SEAT else grid[place // 2, place % 2])
            draw(axes, name)
            axes.set_title(words(name), loc="left", fontweight="bold")
            axes.set_xlim(times_s.min(), times_s.max() + 1e-3)  # one instant alone has no span
            axes.tick_params(length=2.5, width=0.6)
        figure.supylabel("vertical acceleration, m/s²", fontsize=8.0, color="#52606d")
        axes.set_xlabel("seconds since the first predicted instant", color="#52606d")
        return _markup(figure)


def _steps(envelope: Envelope, column: int, origin_ns: int) -> tuple[Floats, Floats, Floats]:
    """Seconds, smallest and largest of one channel, each bin over its whole width, NaN where bins are missing."""
    edges_ns = np.column_stack([envelope.begins_ns, envelope.begins_ns + envelope.width_ns]).ravel()
    apart = 2 * np.flatnonzero(np.diff(envelope.begins_ns) > envelope.width_ns) + 2
    low, high = np.repeat(envelope.low_mps2[:, column], 2), np.repeat(envelope.high_mps2[:, column], 2)
    seconds = _seconds(edges_ns, origin_ns)
    return np.insert(seconds, apart, np.nan), np.insert(low, apart, np.nan), np.insert(high, apart, np.nan)


def _line(stamps_ns: Integers, values: Floats, origin_ns: int) -> tuple[Floats, Floats]:
    """Seconds and values, with a NaN wherever stamps jump, so that no line crosses a gap."""
    steps = np.diff(stamps_ns)
    usual = np.median(steps) if steps.size else 0.0
    apart = np.flatnonzero((steps > 5.0 * usual) | (steps < 0)) + 1
    return np.insert(_seconds(stamps_ns, origin_ns), apart, np.nan), np.insert(values, apart, np.nan)


def _extent(measured: Floats | None, predicted: Floats | None) -> float:
    """Half the height of a panel: the measurement fills it, and a prediction beyond three times that is cut off."""
    largest = [
        float(np.nanmax(np.abs(v))) if v is not None and np.isfinite(v).any() else 0.0 for v in (measured, predicted)
    ]
    room = max(largest[0], min(largest[1], 3.0 * largest[0])) if largest[0] > 0.0 else min(largest[1], 1e6)
    return 1.08 * room or 1.0


def _note(name: str, measured: Floats | None, document: dict[str, Any]) -> str:
    if name == SEAT:
        return "measured: what drives the model"
    if measured is None or not np.isfinite(measured).any():
        return "not measured"
    residual = document["residual"].get(name)
    if residual is None:
        return ""
    share = residual["nrmse_rms_percent"]
    percent = "" if share is None else f", {number(share)} %"
    return f"whole record: residual {number(residual['rms_mps2'])} m/s² rms{percent}"


def _seconds(stamps_ns: Integers, origin_ns: int) -> Floats:
    return np.multiply(stamps_ns - origin_ns, 1e-9, dtype=np.float64)


def _markup(figure: Any) -> Any:
    """A figure as SVG inside HTML: without prolog, metadata and names that a second drawing repeats, numbers short."""
    from markupsafe import Markup

    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None})
    text = file.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r' id="[A-Za-z]+\w*_\d+"', "", text)
    # Hundredths of a point are finer than any screen or printer, and half of the file.
    text = re.sub(r' d="[^"]+"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path.group()), text)
    return Markup(text)  # noqa: S704  # drawn from numbers and our own names only
