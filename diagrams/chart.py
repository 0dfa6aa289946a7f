"""Drawings of recorded signals over time, which show themselves in a notebook."""

import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

# More lines than these in one drawing are told apart by nobody.
_MOST_IN_LEGEND = 6
_WIDTH, _ROW, _REST = 7.0, 1.6, 0.6  # of a figure, of one signal, of the axis of time [inch]
_DEGREE = math.degrees(1.0)


class Chart(Figure):
    """A figure that a notebook shows, whatever Matplotlib's backend is."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def plot_signals(
    time: NDArray[np.float64],
    signals: Mapping[str, NDArray[np.float64]],
    units: Mapping[str, str],
) -> Chart:
    """Draws signals over time, one below the other, each unit by itself; angles in degrees.

    Args:
        time: (n) [s].
        signals: by name (n, size), in the order in which they are drawn.
        units: by name the unit of the elements, separated by commas where they differ.
    """
    rows = [
        (name, *group)
        for name, samples in signals.items()
        for group in _groups(units[name], samples.shape[1])
    ]
    chart = Chart(figsize=(_WIDTH, _REST + _ROW * len(rows)), layout="constrained")
    drawn: Any = chart.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (name, unit, elements) in zip(drawn, rows, strict=True):
        factor = _DEGREE if unit.startswith("rad") else 1.0
        lines = [
            axes.plot(time, factor * signals[name][:, i], f"C{i % 10}", linewidth=1.2)[0]
            for i in elements
        ]
        axes.set_title(name, loc="left", fontsize="medium")
        axes.set_ylabel(f"[{re.sub('^rad', 'deg', unit)}]")
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
        if 1 < len(lines) <= _MOST_IN_LEGEND:
            axes.legend(
                lines,
                [str(i + 1) for i in elements],
                ncols=len(lines),
                **{"loc": "lower right", "bbox_to_anchor": (1.0, 1.0)},
                **{"frameon": False, "fontsize": "small", "borderpad": 0.0},
            )
    drawn[-1].set_xlabel("time [s]")
    return chart


def units_of(unit: str, size: int) -> list[str]:
    """Unit of each element of a signal; that of all of them where it cannot be told.

    "rad, rad, m" are those of three elements, "m, m/s" positions and then as many rates, and so is
    "rad, rad, m, and their rates".

    Args:
        unit: as the signal's declaration has it.
        size: number of elements.
    """
    base, rates = re.fullmatch(r"(.*?)(,? and (?:their )?rates)?", unit).groups()  # type: ignore[union-attr]
    each = [text.strip() for text in base.split(",")]
    if rates:
        each += [f"{text}/s" for text in each]
    parts = size // len(each)
    if size == len(each) or (len(each) > 1 and size % len(each) == 0 and _are_rates(each)):
        return [text for text in each for _ in range(parts)]
    return [unit] * size


def _are_rates(units: Sequence[str]) -> bool:
    """Whether the units after the first one are of derivatives."""
    return all("/s" in unit for unit in units[1:])


def _groups(unit: str, size: int) -> Iterator[tuple[str, list[int]]]:
    """Elements beside each other that have the same unit, with it."""
    each = units_of(unit, size)
    for shared, elements in groupby(range(size), key=each.__getitem__):
        yield shared, list(elements)
