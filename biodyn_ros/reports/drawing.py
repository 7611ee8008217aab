"""Figures of the reports: matplotlib as inline SVG, measured in grey and predicted in orange."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import Any, Final

import numpy as np

MEASURED_COLOUR: Final = "#1f2933"
PREDICTED_COLOUR: Final = "#d9480f"
BAND_COLOUR: Final = "#a9b5c0"
OTHER_COLOUR: Final = "#1971c2"
"""Colour of a second model: the linear or the fitted one."""

PALETTE: Final = {
    "measured": MEASURED_COLOUR, "predicted": PREDICTED_COLOUR, "band": BAND_COLOUR, "other": OTHER_COLOUR,
}  # fmt: skip
"""The colours of the drawings, by the names in the legends."""
SOFT_COLOUR: Final = "#52606d"

DASHED: Final = (0, (4.0, 3.0))
"""For predictions: the gaps show the measurement under an overlapping line."""

DOTTED: Final = (0, (1.0, 1.6))

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
    "xtick.color": SOFT_COLOUR,
    "ytick.color": SOFT_COLOUR,
}


def drawn(width_in: float, height_in: float, fill: Callable[[Any], None]) -> Any:
    """A figure in the style of the reports, drawn by `fill(figure)`, as markup."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context():
        mpl.rcdefaults()  # independent of the user's style
        mpl.rcParams.update(_STYLE)
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        fill(figure)
        _fix_layout(figure)
        return _markup(figure)


def say(axes: Any, text: str) -> None:
    """Write the reason into empty axes."""
    axes.set_yticks([])
    axes.minorticks_off()
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=SOFT_COLOUR)


def _fix_layout(figure: Any) -> None:
    """Round the layout to 1e-6: the solver's last digits differ between runs and enter the names of clip paths."""
    figure.get_layout_engine().execute(figure)
    figure.set_layout_engine("none")
    for axes in figure.axes:
        axes.set_position(np.round(axes.get_position().bounds, 6))


def _markup(figure: Any) -> Any:
    """A figure as SVG for HTML: without prolog, metadata and repeated ids, with short numbers."""
    from markupsafe import Markup
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    file = io.StringIO()
    # `savefig` would draw all twice, the first time for the layout, which is done.
    FigureCanvasSVG(figure).print_svg(file, metadata={"Date": None})
    text = file.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r' id="[A-Za-z]+\w*_\d+"', "", text)
    # Further digits are below the resolution of screens and printers, and half of the file.
    text = re.sub(r' d="[^"]+"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path.group()), text)
    return Markup(text)  # noqa: S704  # contains numbers and names of this package only
