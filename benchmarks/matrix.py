"""Table of what is broken on a machine and what comes of it, written as its rows come."""

import json
import math
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from benchmarks.report import Measurement

# Verdicts.
OK, HARMLESS, SKIPPED = "ok", "harmless", "skipped"
# With more programs a core that want to compute, a missed bound may be theirs; so many times it is
# measured then.
_BUSY, _ATTEMPTS = 1.0, 3
_LONGEST_WORDS = 100  # of a program that are shown; the file has all of them


@dataclass(frozen=True)
class Row:
    """One cell of the matrix.

    Attributes:
        machine: machine and job.
        cell: what was broken.
        found: last words of the program.
        after: time until the machine answered [s]; None: it did not.
        bound: longest time for that [s]; None: no answer is asked for.
        code: exit code of the program; None: none is judged.
        is_live: whether outputs were live in the end; None: there was nothing to look at.
        remark: reason for which the cell is skipped or its fault does no harm, further findings,
            or what went wrong with the measurement.
        is_broken: whether anything else than the figures is not as it must be.
        is_skipped: whether it could not be measured here.
    """

    machine: str
    cell: str
    found: str = ""
    after: float | None = None
    bound: float | None = None
    code: int | None = None
    is_live: bool | None = None
    remark: str = ""
    is_broken: bool = False
    is_skipped: bool = False

    @property
    def verdict(self) -> str:
        """ "ok", "harmless", "skipped", or what is not as it must be."""
        if self.is_skipped:
            return SKIPPED
        wrong = ["broken"] if self.is_broken else []
        if self.is_live:
            wrong.append("live")
        if self.bound is None:
            return ", ".join(wrong) or HARMLESS
        if self.code == 0:
            wrong.append("exit code 0")
        if self.after is None:
            wrong.append("not found")
        elif self.after > self.bound:
            wrong.append("late")
        return ", ".join(wrong) or OK

    @property
    def passed(self) -> bool:
        return self.verdict in (OK, HARMLESS, SKIPPED)

    def as_json(self) -> dict[str, object]:
        return asdict(self) | {"verdict": self.verdict}


class Matrix:
    """Rows that have been measured; the file is whole after each of them."""

    def __init__(
        self,
        console: Console,
        path: Path | None = None,
        load: Callable[[], float] | None = None,
    ):
        """Begins the table.

        Args:
            console: each row is printed on it as it comes.
            path: file for all of them in JSON; None: none.
            load: programs that want to compute, for each core.
        """
        self._load = load or load_of_this_computer
        self.rows: list[Row] = []
        self._console, self._path = console, path
        self._began = time.monotonic()

    def add(self, row: Row) -> None:
        """Takes a row over."""
        self.rows.append(row)
        text = f"  {row.machine}: {row.cell}: {row.verdict}; {_seconds(row.after)}; "
        self._console.print(text + (row.found or row.remark)[:120], markup=False, highlight=False)
        self._write()

    def measure(self, machine: str, cell: str, measured: Callable[[], Row]) -> bool:
        """Measures a row; whether it could be. What goes wrong is a row as well.

        What a busy computer has missed is measured again, and that is said; outputs that were
        live are not.
        """
        for attempt in range(1, _ATTEMPTS + 1):
            row = _measured(machine, cell, measured)
            load = self._load()
            if attempt > 1 or (not row.passed and load > _BUSY):
                said = f"measured {attempt} times, load {load:.1f} a core"
                row = replace(row, remark="; ".join(filter(None, (row.remark, said))))
            if row.passed or row.is_live or load <= _BUSY:
                break
        self.add(row)
        return not row.is_broken

    def _write(self) -> None:
        if self._path is None:
            return
        found = {
            "seconds": round(time.monotonic() - self._began, 1),
            "passed": all(row.passed for row in self.rows),
            "rows": [row.as_json() for row in self.rows],
        }
        temporary = self._path.with_name(f".{self._path.name}")
        temporary.write_text(json.dumps(found, indent=1, default=str) + "\n")
        os.replace(temporary, self._path)

    def print(self) -> None:
        """Prints a table for each machine."""
        for machine in dict.fromkeys(row.machine for row in self.rows):
            table = Table(
                *("cell", "after s", "<= s", "exit", "live", "", "found as; remarks"),
                title=machine,
                title_justify="left",
                box=box.SIMPLE_HEAD,
                padding=(0, 1, 0, 0),
                pad_edge=False,
            )
            for column in table.columns[:-1]:
                column.no_wrap = True
            for row in self.rows:
                if row.machine == machine:
                    table.add_row(*map(escape, _cells(row)))
            self._console.print(table)

    def measurements(self) -> list[Measurement]:
        """Sums, beside other benchmarks' figures."""
        results = []
        for machine in dict.fromkeys(row.machine for row in self.rows):
            here = [row for row in self.rows if row.machine == machine]
            missed = [f"{row.cell} ({row.verdict})" for row in here if not row.passed]
            of = f"{machine}: cells that are not as they must be, of {len(here)}"
            if missed:
                of += f": {', '.join(missed)}"
            results.append(Measurement(of, len(missed), "", 0, None, True))
            live = sum(bool(row.is_live) for row in here)
            words = f"{machine}: jobs that leave outputs live"
            results.append(Measurement(words, live, "", 0, None, True))
        return results


def _measured(machine: str, cell: str, measured: Callable[[], Row]) -> Row:
    """A row, of an error as well."""
    try:
        return measured()
    except Exception as error:
        words = " ".join(f"{type(error).__name__}: {error}".split())
        return Row(machine, cell, remark=words, is_broken=True)


def _cells(row: Row) -> tuple[str, ...]:
    """Cells of a row."""
    found, _, _ = row.found.partition("; ")
    words = "; ".join(filter(None, (found[:_LONGEST_WORDS], row.remark)))
    return (
        row.cell,
        _seconds(row.after),
        "" if row.bound is None else f"{row.bound:g}",
        "" if row.code is None else str(row.code),
        "-" if row.is_live is None else "yes" if row.is_live else "no",
        row.verdict,
        words,
    )


def load_of_this_computer() -> float:
    """Programs that want to compute, for each core."""
    return os.getloadavg()[0] / len(os.sched_getaffinity(0))


def _seconds(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.2f}"
