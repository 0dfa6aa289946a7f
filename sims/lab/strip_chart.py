"""Strip chart: the newest samples of a loop's usual plots, which a page draws while it runs."""

import math
import threading
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from parapod.diagrams.machine import Machine
from parapod.diagrams.plots import Limits, Signals, choose, usual
from parapod.sims.lab.stacked_plots import axis, black, layout, limit_line, traces
from parapod.systems.core.extras import need

# Between two samples, and from the oldest to the newest of them [s].
PERIOD, LENGTH = 0.05, 20.0
_DIGITS = 6  # digits of a number on the page


class StripChart:
    """The newest samples of some curves, added by a simulation and read by pages.

    Both may be threads of their own. A time that goes back begins the chart anew.

    Attributes:
        signals: names of the signals that are drawn.
        description: axes and curves, as the page takes them.
    """

    def __init__(
        self, machine: Machine[Any], sizes: Mapping[str, int], limits: Limits | None = None
    ):
        """Chooses the curves: those of the machine's usual plots that there are.

        Args:
            machine: the machine.
            sizes: number of elements of each signal that there is, by port name.
            limits: smallest and largest admissible value of signals; None: those of the ports.

        Raises:
            MissingExtra: plotly is not installed.
        """
        need("plotly")
        names = [name for name in sizes if name in machine.table]
        units = {name: machine.unit(name) for name in names}
        ends = machine.limits_of_ports if limits is None else limits
        there = Signals(
            machine.title, {name: sizes[name] for name in names}, units, machine.element_name
        )
        plots = choose(there, usual(names, machine.plots), ends)
        curves = [(plot, curve) for plot in plots for curve in plot.curves]
        self.signals = tuple(dict.fromkeys(curve.signal for _, curve in curves))
        self._elements = [(curve.signal, curve.element, plot.factor) for plot, curve in curves]
        self._rows: deque[list[float | None]] = deque(maxlen=1 + round(LENGTH / PERIOD))
        self._count, self._newest = 0, -math.inf
        self._lock = threading.Lock()
        declared_curves = traces(plots)
        axes = layout(plots)
        del axes["height"]
        axes["margin"] |= {"l": 50, "r": 6}
        for k in range(len(plots)):  # in one line, although the page has little room
            axes[axis("legend", k)]["font"] = {"size": 9}
        self.description: Mapping[str, Any] = {
            "traces": declared_curves,
            "layout": axes,
            "black": black(declared_curves),
            "limits": [plot.limits for plot in plots],
            "limit_line": limit_line(0, 0.0),
            "places": [k for k, plot in enumerate(plots) for _ in plot.curves],
            "length": LENGTH,
        }

    def __repr__(self) -> str:
        return f"<strip chart of {', '.join(self.signals)}>"

    def wants(self, t: float) -> bool:
        """Whether it is time for a sample."""
        return not self._newest <= t < self._newest + PERIOD * (1.0 - 1e-9)

    def add(self, t: float, values: Mapping[str, ArrayLike]) -> None:
        """Adds a sample.

        Args:
            t: time [s].
            values: values of each of the signals.
        """
        flat = {name: np.asarray(values[name], dtype=float).ravel() for name in self.signals}
        row = [round(t, 3), *(_short(f * flat[name][k]) for name, k, f in self._elements)]
        with self._lock:
            if t < self._newest:
                self._rows.clear()
            self._newest = t
            self._rows.append(row)
            self._count += 1

    def since(self, number: int) -> dict[str, Any]:
        """Samples that a page does not know yet.

        Args:
            number: number of samples that had been added at the page's last request.

        Returns:
            `number` of those added by now, and the newest `rows`: the time and a value for each
            curve, None where it is not finite.
        """
        with self._lock:
            new = min(max(0, self._count - number), len(self._rows))
            return {"number": self._count, "rows": [*self._rows][len(self._rows) - new :]}


def _short(value: float) -> float | None:
    """A number as a page needs it; None: it is not finite."""
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
