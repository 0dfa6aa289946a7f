"""Recorded signals of a run, by the names of their ports and with their units."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.errors import ParapodError

if TYPE_CHECKING:
    from parapod.diagrams.chart import Chart

type Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Recording(Mapping[str, Floats]):
    """Signals over time: `recording["truth.posture"]` are samples (n, size).

    Attributes:
        time: (n) times of the samples [s].
        signals: port name -> (n, size) samples.
        units: port name -> unit of its elements, separated by commas where they differ.
    """

    time: Floats
    signals: Mapping[str, Floats]
    units: Mapping[str, str]

    def __getitem__(self, name: str) -> Floats:
        """Samples (n, size) of a signal.

        Raises:
            ParapodError: a signal that was not recorded.
        """
        if name not in self.signals:
            names = ", ".join(sorted(self.signals)) or "none"
            raise ParapodError(f"no signal '{name}' was recorded; there are: {names}")
        return self.signals[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.signals)

    def __len__(self) -> int:
        return len(self.signals)

    def __contains__(self, name: object) -> bool:
        return name in self.signals

    def __repr__(self) -> str:
        ends = f"{self.time[0]:g}..{self.time[-1]:g} s" if self.time.size else "no samples"
        return f"<Recording of {len(self.signals)} signals, {self.time.size} samples, {ends}>"

    def _repr_html_(self) -> str:
        """A table of the signals that folds out, for notebooks."""
        rows = "".join(
            f"<tr><td style='text-align:left'>{name}</td><td>{samples.shape[1]}</td>"
            f"<td style='text-align:left'>{self.units[name]}</td></tr>"
            for name, samples in sorted(self.signals.items())
        )
        head = "".join(
            f"<th style='text-align:{side}'>{text}</th>"
            for text, side in (("signal", "left"), ("size", "right"), ("unit", "left"))
        )
        table = f"<table><tr>{head}</tr>{rows}</table>"
        return f"<details><summary>{repr(self)[1:-1]}</summary>{table}</details>"

    def after(self, time: float) -> Self:
        """The samples from a time [s] on."""
        later = self.time >= time
        signals = {name: samples[later] for name, samples in self.signals.items()}
        return replace(self, time=self.time[later], signals=signals)

    def plot(self, *plots: str) -> "Chart":
        """Draws signals over time, one below the other; a Matplotlib figure that shows itself.

        Elements of different units have plots of their own, in the units that people read: mm
        and deg.

        Args:
            plots: `signal`, `signal[0]` or `signal[0:3]`, several joined by + in one plot; none
                for all signals.

        Raises:
            ParapodError: a signal that was not recorded, or an element that does not exist.
        """
        from parapod.diagrams.chart import plot_signals

        return plot_signals(self.time, self.signals, self.units, plots or tuple(self))


def spans(flags: ArrayLike) -> list[tuple[int, int]]:
    """Intervals of samples in which flags are up: the first one, and the one after the last.

    Args:
        flags: (n) flags.
    """
    edges = np.flatnonzero(np.diff(np.concatenate(([0], np.asarray(flags, dtype=int), [0]))))
    return [(int(begin), int(end)) for begin, end in edges.reshape(-1, 2)]
