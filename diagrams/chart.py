"""Drawings of plots over time, which show themselves in a notebook."""

import io
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from parapod.diagrams.plots import Curve, Plot, Signals, choose
from parapod.diagrams.style import style

_COLUMNS = 6  # columns of a legend
_WIDTH, _ROW, _REST = (
    7.0,
    1.7,
    0.6,
)  # of a figure; of a plot; of the rest


class Chart(Figure):
    """A figure that a notebook shows, whatever Matplotlib's backend is."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        with rc_context(style()):
            self.savefig(buffer, format="png")
        return buffer.getvalue()


def plot_signals(
    time: NDArray[np.float64],
    signals: Mapping[str, NDArray[np.float64]],
    units: Mapping[str, str],
    names: Sequence[str],
) -> Chart:
    """Draws signals over time, one plot below the other, in the units that people read.

    Args:
        time: (n) [s].
        signals: samples (n, size) by signal.
        units: unit of the elements by signal, separated by commas where they differ.
        names: plots, as `choose` has them.

    Raises:
        NoSignal: a signal or an element does not exist.
    """
    sizes = {name: samples.shape[1] for name, samples in signals.items()}
    plots = choose(Signals("the recording", sizes, units), names, {})

    def line(plot: Plot, curve: Curve) -> tuple[ArrayLike, ArrayLike]:
        return time, plot.factor * signals[curve.signal][:, curve.element]

    with rc_context(style()):
        chart = Chart(figsize=(_WIDTH, _REST + _ROW * len(plots)), layout="constrained")
        draw_plots(chart, plots, line)
    return chart


def draw_plots(
    canvas: Any,
    plots: Sequence[Plot],
    lines: Callable[[Plot, Curve], tuple[ArrayLike, ArrayLike] | None],
    **properties: Any,
) -> list[Any]:
    """Draws plots one above the other, over what is there of an earlier call.

    Args:
        canvas: figure of Matplotlib.
        plots: the plots.
        lines: times (n) [s] and values (n), in the plot's unit, of a curve; None: it is not drawn.
        properties: properties of the lines, beside colour, width and label.

    Returns:
        The axes of each plot.
    """
    rows = canvas.axes or canvas.subplots(len(plots), 1, sharex=True, squeeze=False)[:, 0]
    for axes, plot in zip(rows, plots, strict=True):
        labels = [text.get_label() for text in axes.lines]
        for place, curve in enumerate(plot.curves):
            if (line := lines(plot, curve)) is None:
                continue
            label = plot.legend[place]
            axes.plot(
                *line,
                color=plot.colours[place],
                linewidth=2.4 if plot.is_first(curve) else 1.1,
                label=None if label in labels else label,
                **properties,
            )
        axes.set_ylabel(plot.quantity)
        above = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.1}
        columns = min(len(plot.curves), _COLUMNS)
        axes.legend(ncols=columns, fontsize="small", columnspacing=1.2, **above)
    rows[-1].set_xlabel("time [s]")
    return list(rows)
