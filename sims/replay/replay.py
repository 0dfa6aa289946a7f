"""Logs as they are replayed: one alone, or laid over another.

The walking chair's steps are counted over all samples, also of what is before `--between` and of
those between two pictures.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from parapod.diagrams.plots import Curve, Plot, Signals, choose, usual
from parapod.sims.lab.subject import Subject
from parapod.sims.output.logs.stored import StoredLog, open_log
from parapod.sims.replay.digest import Digest, gather
from parapod.systems.core.quoting import quoted_path

# Limits are drawn up to this distance from the curves, by the curves' height [-].
_REACH = 2.0
# Heights of plots by their units, below which there is nothing but rounding to be seen.
_LEAST = {"deg": 0.01, "mm": 0.01, "deg/s": 0.1, "mm/s": 0.1, "N": 0.1, "V": 0.01, "A": 0.01}


@dataclass(frozen=True)
class Replay:
    """A log with what is to be seen of it.

    Attributes:
        subject: machine and experiment of the log.
        plots: the plots, those of both where it is laid over another log.
        digest: its content.
    """

    subject: Subject
    plots: list[Plot]
    digest: Digest

    def has(self, curve: Curve) -> bool:
        """Whether a curve is in this log, of two that share their plots."""
        line = self.digest.lines.get(curve.signal)
        return line is not None and curve.element < line.values.shape[1]

    def values(self, plot: Plot, curve: Curve) -> NDArray[np.float64]:
        """Values of a curve that is in this log, in the plot's unit."""
        values: NDArray[np.float64] = self.digest.lines[curve.signal].values[:, curve.element]
        return plot.factor * values

    @property
    def remarks(self) -> list[str]:
        """Sentences on what is not as it might be."""
        return [*self.subject.remarks, *self.digest.remarks]


def near_limits(logs: Sequence[Replay], number: int) -> list[float]:
    """Limits of a plot that are near its curves, which those far away would make flat lines.

    Args:
        logs: logs that share the plot.
        number: index of the plot.
    """
    ends = _ends(logs, number)
    if ends is None:
        return []
    low, high = ends
    reach = _REACH * (high - low)
    return [
        limit for limit in logs[0].plots[number].limits if low - reach <= limit <= high + reach
    ]


def least_ends(logs: Sequence[Replay], number: int) -> tuple[float, float] | None:
    """Ends of the axis of a plot whose curves differ by less than its unit lets one see.

    Args:
        logs: logs that share the plot.
        number: index of the plot.

    Returns:
        Both ends; None where the curves are higher than that.
    """
    ends = _ends(logs, number)
    least = _LEAST.get(logs[0].plots[number].unit, 0.0)
    if ends is None or ends[1] - ends[0] >= least:
        return None
    middle = 0.5 * (ends[0] + ends[1])
    return middle - 0.5 * least, middle + 0.5 * least


def _ends(logs: Sequence[Replay], number: int) -> tuple[float, float] | None:
    """Smallest and largest value of a plot's curves; None: there is none."""
    plot = logs[0].plots[number]
    values = [
        each.values(plot, curve) for each in logs for curve in plot.curves if each.has(curve)
    ]
    finite = np.concatenate(values)
    finite = finite[np.isfinite(finite)]
    return (float(finite.min()), float(finite.max())) if finite.size else None


def open_replays(
    path: Path,
    against: Path | None,
    requests: Sequence[str],
    console: Console,
    *,
    between: tuple[float, float] | None = None,
    is_drawn: bool = True,
) -> tuple[Replay, Replay | None]:
    """Reads a log, and another one that is laid over it.

    Args:
        path: the log.
        against: the other log, or None.
        requests: plots, see `choose`; none: the usual ones.
        console: console for progress.
        between: first and last time that is wanted [s]; None: all.
        is_drawn: true if the machines are drawn.

    Returns:
        The log, and the other one with the same plots, or None. Each has those of the curves that
        its log has.

    Raises:
        OutputError: a log cannot be read.
        NoSignal: no log has what is asked for.
        ParapodError: a log without a sample.
    """
    log = open_log(path)
    subject = Subject.from_metadata(path.name, log.shapes, log.metadata, is_drawn)
    both: list[tuple[StoredLog, Subject]] = [(log, subject)]
    owner = quoted_path(path)
    if against is not None:
        other = open_log(against)
        label = f"{against.name} (other)" if against.name == path.name else against.name
        both.append((other, Subject.from_metadata(label, other.shapes, other.metadata, is_drawn)))
        owner += f" or {quoted_path(against)}"
        _lay_by_clock(log, other, both[1][1])
    sizes: dict[str, int] = {}
    units: dict[str, str] = {}
    for each, _ in reversed(both):
        sizes |= each.sizes
        units |= each.units
    machine = subject.machine
    signals = (
        Signals(owner, sizes, units)
        if machine is None
        else Signals(owner, sizes, units, machine.element_name)
    )
    measured = getattr(subject.experiment, "signals", ())
    names = list(requests) or usual(signals.sizes, subject.plots, measured)
    plots = choose(signals, names, subject.limits)
    replays = []
    for each, of in both:
        curves = [curve for plot in plots for curve in plot.curves]
        missing = [c.label for c in curves if c.element >= each.sizes.get(c.signal, 0)]
        if missing:
            of.remarks.append(f"{of.label} has no {', '.join(missing)}")
        there = dict.fromkeys(c.signal for c in curves if c.signal in each.sizes)
        sources = {} if of.drawn is None else of.drawn.sources
        drawn_names = list(dict.fromkeys(sources.values()))
        tracker = None if of.drawn is None else of.drawn.tracker()
        digest = gather(each, there, drawn_names, of.phase, console, between, tracker)
        replays.append(Replay(of, plots, digest))
    return replays[0], replays[1] if len(replays) > 1 else None


def _lay_by_clock(log: StoredLog, other: StoredLog, subject: Subject) -> None:
    """Moves a log that was written at the same time as the first, and says so.

    A controller and the emulator of its machine begin to count their times at different moments.

    Args:
        log: the first log.
        other: one that is laid over it.
        subject: machine and experiment of the other log.

    Raises:
        OutputError: a log cannot be read.
    """
    if log.clock is None or other.clock is None:
        return
    later = other.clock - log.clock
    ends, others = log.ends(), other.ends()
    if ends and others and ends[0] < others[1] + later and others[0] + later < ends[1]:
        other.shift = later
        subject.remarks.append(
            f"{subject.label} was written at the same time: it is laid by the computer's clock, "
            f"{abs(later):.2f} s {'later' if later > 0.0 else 'earlier'} than by its own time"
        )
