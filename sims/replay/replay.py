"""Logs as they are replayed: one alone, or laid over another."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from parapod.sims.lab.stored_log import StoredLog, open_log
from parapod.sims.lab.subject import Subject
from parapod.sims.replay.digest import Digest, gather
from parapod.sims.replay.plots import Plot, choose, usual

# A limit is near that is no further from the curves than so many times their height.
_REACH = 2.0


@dataclass(frozen=True)
class Replay:
    """A log with what is to be seen of it.

    Attributes:
        subject: what it is of.
        plots: the plots.
        digest: its content.
    """

    subject: Subject
    plots: list[Plot]
    digest: Digest

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
    plot = logs[0].plots[number]
    values = [
        plot.factor * each.digest.lines[curve.signal].values[:, curve.element]
        for each in logs
        for curve in each.plots[number].curves
    ]
    known = np.concatenate(values)
    known = known[np.isfinite(known)]
    if not known.size:
        return []
    low, high = float(known.min()), float(known.max())
    reach = _REACH * (high - low)
    return [limit for limit in plot.limits if low - reach <= limit <= high + reach]


def open_replays(
    path: Path,
    against: Path | None,
    asked: Sequence[str],
    console: Console,
    *,
    between: tuple[float, float] | None = None,
    is_drawn: bool = True,
) -> tuple[Replay, Replay | None]:
    """Reads a log, and another one that is laid over it.

    Args:
        path: the log.
        against: the other log, or None.
        asked: plots, see `choose`; none: the usual ones.
        console: console for progress.
        between: first and last time that is wanted [s]; None: all.
        is_drawn: whether the machines are drawn.

    Returns:
        The log, and the other one with those of the plots' signals that it has, or None.

    Raises:
        OutputError: a log cannot be read.
        NoSignal: the log does not have what is asked for.
        ParapodError: a log without a sample.
    """
    log = open_log(path)
    other = open_log(against) if against is not None else None
    subject = Subject.of(path.name, log.shapes, log.metadata, is_drawn)
    signals = getattr(subject.experiment, "signals", ())
    wanted = list(asked) or usual(log, subject.machine, signals)
    plots = choose(log, wanted, subject.limits)
    replay = Replay(subject, plots, _gather(log, subject, plots, console, between))
    if other is None:
        return replay, None
    assert against is not None
    label = f"{against.name} (other)" if against.name == path.name else against.name
    with_it = Subject.of(label, other.shapes, other.metadata, is_drawn)
    there = _there(other, plots, with_it)
    return replay, Replay(with_it, there, _gather(other, with_it, there, console, between))


def _there(log: StoredLog, plots: Sequence[Plot], subject: Subject) -> list[Plot]:
    """The same plots, with what another log has of them."""
    found = []
    missing: list[str] = []
    for plot in plots:
        curves = tuple(c for c in plot.curves if c.element < log.size(c.signal))
        missing += [c.label for c in plot.curves if c not in curves]
        found.append(Plot(curves, plot.unit, plot.factor, plot.limits))
    if missing:
        subject.remarks.append(f"{subject.label} has no {', '.join(missing)}")
    return found


def _gather(
    log: StoredLog,
    subject: Subject,
    plots: Sequence[Plot],
    console: Console,
    between: tuple[float, float] | None,
) -> Digest:
    signals = dict.fromkeys(curve.signal for plot in plots for curve in plot.curves)
    drawn = list(dict.fromkeys(subject.drawn_by.values()))
    return gather(log, signals, drawn, subject.phase, console, between)
