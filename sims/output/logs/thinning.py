"""Logs of any length as a page can show them: extremes for lines, and single rows for pictures.

Both take a log piece by piece and hold a bounded number of rows; whenever there are too many, two
neighbours become one.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

type Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Line:
    """A signal over time, as a line is drawn.

    Attributes:
        time: (m) [s].
        values: (m, columns).
        bucket: number of rows between which each pair of points tells the extremes; 1: these are
            all rows.
    """

    time: Floats
    values: Floats
    bucket: int


class Extremes:
    """Smallest and largest value of each column in buckets of equally many rows.

    A spike of one row stays, however long the log is. NaN is left out, and remains where there is
    nothing else.
    """

    def __init__(self, columns: int, most: int = 2000):
        """Holds nothing yet.

        Args:
            columns: number of columns.
            most: number of buckets that it ends with at most, and half of it at least, if there
                are this number of rows.
        """
        self._columns, self._most = columns, most
        self._size = 1  # rows in a bucket
        self._rest = np.empty(0), np.empty((0, columns))
        # By bucket: first and last time, extremes, and the rows in which these stand.
        self._times = np.empty((0, 2))
        self._found = np.empty((0, 2, columns))
        self._rows = np.empty((0, 2, columns), dtype=np.int64)
        self._count = 0  # rows in whole buckets

    def add(self, time: Floats, values: Floats) -> None:
        """Takes further rows.

        Args:
            time: (k) [s].
            values: (k, columns).
        """
        time = np.concatenate((self._rest[0], time))
        values = np.concatenate((self._rest[1], values))
        count = len(time) // self._size
        # The number with which buckets can be merged in pairs until there are few enough.
        merges = max(0, math.ceil(math.log2((len(self._times) + count) / self._most or 1)))
        count -= (len(self._times) + count) % 2**merges
        end = count * self._size
        self._rest = time[end:], values[end:]
        self._take(time[:end], values[:end], self._size)
        while len(self._times) > self._most:
            self._merge()

    def line(self) -> Line:
        """The points to draw: of each bucket the extremes, in the order in which they came."""
        time, values = self._rest
        self._rest = time[:0], values[:0]
        end = len(time) - len(time) % self._size
        self._take(time[:end], values[:end], self._size)
        self._take(time[end:], values[end:], len(time) - end)
        if self._size == 1:
            return Line(self._times[:, 0], self._found[:, 0], 1)
        falls = self._rows[:, 0] > self._rows[:, 1]
        first = np.where(falls, self._found[:, 1], self._found[:, 0])
        last = np.where(falls, self._found[:, 0], self._found[:, 1])
        values = np.stack((first, last), axis=1).reshape(-1, self._columns)
        return Line(self._times.ravel(), values, self._size)

    def _take(self, time: Floats, values: Floats, size: int) -> None:
        if not len(time):
            return
        buckets = values.reshape(-1, size, self._columns)
        unknown = np.isnan(buckets)
        low = np.where(unknown, np.inf, buckets).argmin(axis=1)[:, None]
        high = np.where(unknown, -np.inf, buckets).argmax(axis=1)[:, None]
        first = self._count + size * np.arange(len(buckets))[:, None]
        extremes = [np.take_along_axis(buckets, each, axis=1)[:, 0] for each in (low, high)]
        rows = [first + each[:, 0] for each in (low, high)]
        times = time.reshape(-1, size)[:, [0, -1]]
        self._times = np.concatenate((self._times, times))
        self._found = np.concatenate((self._found, np.stack(extremes, axis=1)))
        self._rows = np.concatenate((self._rows, np.stack(rows, axis=1)))
        self._count += len(time)

    def _merge(self) -> None:
        """Makes one bucket of each two."""
        merged, rows = [], []
        for k, (nothing, best) in enumerate(((np.inf, np.argmin), (-np.inf, np.argmax))):
            each = self._found[:, k].reshape(-1, 2, self._columns)
            place = best(np.where(np.isnan(each), nothing, each), axis=1)[:, None]
            merged.append(np.take_along_axis(each, place, axis=1)[:, 0])
            there = self._rows[:, k].reshape(-1, 2, self._columns)
            rows.append(np.take_along_axis(there, place, axis=1)[:, 0])
        self._times = self._times.reshape(-1, 4)[:, [0, 3]]
        self._found, self._rows = np.stack(merged, axis=1), np.stack(rows, axis=1)
        self._size *= 2


class Snapshots[R]:
    """Every n-th row, from the first on.

    Attributes:
        rows: the rows that are kept.
    """

    def __init__(self, most: int):
        """Holds nothing yet.

        Args:
            most: largest number of rows at the end; at least half of it, if there are that
                many.
        """
        self.rows: list[R] = []
        self._step, self._most, self._seen = 1, most, 0

    def take(self, row: R) -> None:
        """Takes a row."""
        if self.wants():
            self.rows.append(row)
        self.skip()

    def wants(self) -> bool:
        """Whether the next row is one to keep."""
        return self._seen % self._step == 0

    def skip(self, count: int = 1) -> None:
        """Counts rows; makes room where there are too many."""
        self._seen += count
        while len(self.rows) > self._most:
            self.rows, self._step = self.rows[::2], 2 * self._step

    def until_wanted(self) -> int:
        """Number of rows that come before the next one to keep."""
        return -self._seen % self._step
