"""A log as much of it as can be shown, gathered in one pass."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from rich.console import Console

from parapod.diagrams.twin import Tracker
from parapod.sims.output.logs.stored import StoredLog
from parapod.sims.output.logs.thinning import Extremes, Floats, Line, Snapshots
from parapod.sims.output.progress import counted
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.quoting import quoted_path

# Points of a curve that a page or a figure can show, two for each bucket.
_BUCKETS = 2000
_PICTURES = 900  # pictures of the machine: a page of some MB
_FLUENT = 0.25  # longest time between two pictures of a fluent motion [s]
_PHASES = 400  # more cannot be distinguished


type Picture = tuple[float, Mapping[str, Floats]]


@dataclass(frozen=True)
class Phase:
    """A time in which the phase stays the same.

    Attributes:
        name: its name.
        begin: its beginning [s].
        end: its end [s].
    """

    name: str
    begin: float
    end: float


@dataclass(frozen=True)
class Digest:
    """Content of a log that can be shown.

    Attributes:
        lines: signals over time, their elements as columns, by name.
        pictures: times [s] and the signals by which the machine is drawn.
        phases: phases, one after the other.
        begin: time of the first sample [s].
        end: time of the last one [s].
        rows: number of samples.
        remarks: sentences on what was left out.
    """

    lines: Mapping[str, Line]
    pictures: list[Picture]
    phases: list[Phase]
    begin: float
    end: float
    rows: int
    remarks: list[str]


def gather(
    log: StoredLog,
    plotted: Collection[str],
    drawn_names: Collection[str],
    phase: tuple[str, tuple[str, ...]] | None,
    console: Console,
    between: tuple[float, float] | None = None,
    track: Tracker | None = None,
) -> Digest:
    """Reads a log once, whatever its length.

    Args:
        log: the log.
        plotted: signals to plot.
        drawn_names: signals by which the machine is drawn.
        phase: signal that shows phases and the names of its values; None: there is none.
        console: console for progress.
        between: first and last time that is wanted [s]; None: all.
        track: tells further signals for the drawing, of all samples of `drawn`; None: there are
            none.

    Raises:
        OutputError: the log cannot be read.
        ParapodError: there is no sample, or none between the times.
    """
    names = list(dict.fromkeys([*plotted, *drawn_names, *([phase[0]] if phase else ())]))
    sizes = log.sizes
    extremes = {name: Extremes(sizes[name], _BUCKETS) for name in plotted}
    pictures: Snapshots[Picture] = Snapshots(_PICTURES)
    changes = _Changes()
    first, last = between or (-np.inf, np.inf)
    begin = end = rows = 0.0
    whole = (0.0, 0.0)
    with counted(console, f"reading {log.path.name}", log.total) as report:
        for time, samples in log.pieces(names):
            whole = (whole[0] if rows or whole[1] else float(time[0]), float(time[-1]))
            # Also of what is before the times that are wanted.
            tracked = {} if track is None else track(time, {n: samples[n] for n in drawn_names})
            chosen = (time >= first) & (time <= last)
            if not chosen.all():
                time = time[chosen]
                samples = {name: each[chosen] for name, each in samples.items()}
                tracked = {name: each[chosen] for name, each in tracked.items()}
            if not len(time):
                continue
            begin, end = begin if rows else float(time[0]), float(time[-1])
            rows += len(time)
            for name, each in extremes.items():
                each.add(time, samples[name].reshape(len(time), -1).astype(float))
            if drawn_names:
                _keep(
                    pictures, time, {name: samples[name] for name in drawn_names} | dict(tracked)
                )
            if phase is not None:
                changes.add(time, samples[phase[0]].reshape(len(time), -1)[:, 0])
            report(log.done)
    if not rows:
        if between is not None and whole[1] > whole[0]:
            raise ParapodError(
                f"{quoted_path(log.path)} has no sample from {first:g} to {last:g} s; "
                f"its samples are from {whole[0]:g} to {whole[1]:g} s"
            )
        raise ParapodError(f"{quoted_path(log.path)} has no sample")
    lines = {name: each.line() for name, each in extremes.items()}
    phases, remarks = changes.phases(phase[1] if phase else (), end)
    if log.cut_at is not None:
        remarks.append(
            f"{log.path.name} is cut off; it is shown up to {log.cut_at + log.shift:g} s"
        )
    bucket = max((line.bucket for line in lines.values()), default=1)
    if bucket > 2:  # of two the smallest and the largest are both
        remarks.append(
            f"{log.path.name}: {int(rows)} samples; curves show smallest and largest values "
            f"of each {bucket} of them, {bucket * (end - begin) / rows:.2g} s"
        )
    picture_rows = pictures.rows
    apart = (
        (picture_rows[-1][0] - picture_rows[0][0]) / (len(picture_rows) - 1)
        if len(picture_rows) > 1
        else 0.0
    )
    if apart > _FLUENT:
        remarks.append(f"{log.path.name}: the machine is drawn every {apart:.2g} s")
    return Digest(lines, picture_rows, phases, begin, end, int(rows), remarks)


def _keep(pictures: Snapshots[Picture], time: Floats, samples: Mapping[str, Floats]) -> None:
    """Keeps the rows that are wanted, without looking at each of the others."""
    k = pictures.until_wanted()
    pictures.skip(min(k, len(time)))
    while k < len(time):
        pictures.take(
            (float(time[k]), {name: np.array(each[k], ndmin=1) for name, each in samples.items()})
        )
        ahead = min(pictures.until_wanted(), len(time) - k - 1)
        pictures.skip(ahead)
        k += 1 + ahead
        if not pictures.wants():
            break


class _Changes:
    """Values of a signal, wherever it changes."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._values: list[float] = []

    def add(self, time: Floats, values: Floats) -> None:
        before = self._values[-1:] or [np.nan]
        places = np.flatnonzero(values != np.concatenate((before, values[:-1])))
        if len(self._times) <= _PHASES:
            self._times += time[places].tolist()
            self._values += values[places].tolist()

    def phases(self, names: tuple[str, ...], end: float) -> tuple[list[Phase], list[str]]:
        """The phases up to the end [s], and what is to be remarked."""
        if len(self._times) > _PHASES:
            return [], [f"phases change more than {_PHASES} times and are not shown"]
        ends = [*self._times[1:], end][: len(self._times)]
        finite = [
            names[int(value)] if 0.0 <= value < len(names) else f"{value:g}"
            for value in self._values
        ]
        return [Phase(*each) for each in zip(finite, self._times, ends, strict=True)], []
