"""Plots of a log as a figure: a file, or a window."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.chart import draw_plots
from parapod.diagrams.plots import Curve, Plot
from parapod.sims.output.figures import FORMATS as _FORMATS
from parapod.sims.output.figures import Figure
from parapod.sims.replay.replay import Replay, least_ends, near_limits
from parapod.systems.core.errors import OutputError
from parapod.systems.core.quoting import quoted_path

FORMATS = tuple(f".{suffix}" for suffix in _FORMATS)

# Width of the figure, height of a plot and of what stands around all [inch].
_WIDTH, _HEIGHT, _AROUND = 8.0, 1.9, 0.7
_BANDS = ("#5a7896", "#b9c6d2")
_NAMED = 0.014  # share of the width that a letter of a phase's name takes


def check_format(path: Path) -> None:
    """Refuses a figure whose suffix says no format.

    Raises:
        OutputError: names the formats.
    """
    if path.suffix not in FORMATS:
        formats = ", ".join(FORMATS)
        raise OutputError(
            f"cannot write {quoted_path(path)}: a figure's suffix must be one of {formats}", path
        )


def make_figure(replay: Replay, against: Replay | None) -> Figure:
    """The plots, one above the other.

    Args:
        replay: a log.
        against: one that is laid over it, dashed; or None.
    """
    logs = [replay] if against is None else [replay, against]
    captions = [
        f"{each.subject.label} ({', '.join(each.subject.facts)})"
        if [*each.subject.facts]
        else each.subject.label
        for each in logs
    ]
    remarks = [text for each in logs for text in each.remarks]
    return Figure(
        name="plot",
        title=replay.subject.title,
        caption=". ".join([", dashed ".join(captions), *remarks]),
        draw=lambda canvas: _draw(canvas, logs),
        size=(_WIDTH, _AROUND + _HEIGHT * len(replay.plots)),
    )


def show(figure: Figure) -> None:
    """Shows a figure in a window until that is closed.

    Raises:
        OutputError: there is no screen, or nothing that draws windows.
    """
    import matplotlib
    from matplotlib import pyplot, rc_context

    from parapod.diagrams.style import style

    try:
        with rc_context(style()):
            canvas = pyplot.figure(figsize=figure.size, layout="constrained")
            is_window = matplotlib.get_backend().lower() not in (
                "agg",
                "svg",
                "pdf",
                "ps",
                "cairo",
            )
    except ImportError as error:
        raise _windowless(str(error)) from None
    if not is_window:
        pyplot.close(canvas)
        raise _windowless("there is no screen, or no toolkit such as Tk or Qt")
    with rc_context(style()):
        figure.draw(canvas)
        canvas.suptitle(figure.title)
        pyplot.show(block=True)


def _windowless(reason: str) -> OutputError:
    formats = ", ".join(FORMATS)
    return OutputError(
        f"no window can be opened: {reason}; name a file with --out ({formats})", None
    )


def _line(
    log: Replay, plot: Plot, curve: Curve
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Times and values of a curve, where the log has it."""
    if not log.has(curve):
        return None
    return log.digest.lines[curve.signal].time, log.values(plot, curve)


def _draw(canvas: Any, logs: list[Replay]) -> None:
    first = logs[0]
    begin = min(each.digest.begin for each in logs)
    end = max(each.digest.end for each in logs)
    for number, each in enumerate(logs):
        lines = partial(_line, each)
        rows = draw_plots(canvas, first.plots, lines, linestyle="--" if number else "-")
    for k, (axes, plot) in enumerate(zip(rows, first.plots, strict=True)):
        for limit in near_limits(logs, k):
            of = plot.place_of_limit(limit)
            colour = "0.35" if of is None else plot.colours[of]
            axes.axhline(limit, color=colour, linestyle=":", linewidth=1.2)
        for number, phase in enumerate(first.digest.phases):
            band = _BANDS[number % 2]
            axes.axvspan(phase.begin, phase.end, color=band, alpha=0.15, linewidth=0.0, zorder=0)
            if k == 0 and phase.end - phase.begin >= _NAMED * len(phase.name) * (end - begin):
                middle = 0.5 * (phase.begin + phase.end)
                place = axes.get_xaxis_transform()
                words = {"ha": "center", "va": "top", "fontsize": "small", "color": "0.3"}
                axes.text(middle, 0.99, phase.name, transform=place, **words)
        if least := least_ends(logs, k):
            axes.set_ylim(least)
    if end > begin:
        rows[-1].set_xlim(begin, end)
