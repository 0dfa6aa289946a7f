"""Report of a measurement."""

import sys
from dataclasses import dataclass

from rich.console import Console, JustifyMethod
from rich.table import Table

from benchmarks.yardstick import Pace

# Width of tables that go into a file or a pipe [characters].
_FILE_WIDTH = 130
OK, MISSED, TOO_BUSY = "ok", "missed", "too busy to judge"


def make_console() -> Console:
    """Console of standard output: as wide as the terminal, or wide enough for every table."""
    return Console(width=None if sys.stdout.isatty() else _FILE_WIDTH)


@dataclass(frozen=True)
class Measurement:
    """One figure beside the floor that it must reach and the aim that it should.

    `at_most` turns the floor into a ceiling. A figure with a pace is judged with the machine's
    slowness taken out of it; where the yardstick scattered, it may hold its bound but not miss it.
    """

    name: str
    value: float
    unit: str
    floor: float | None = None
    aim: float | None = None
    at_most: bool = False
    pace: Pace | None = None

    @property
    def judged(self) -> float:
        """The figure in relation to the yardstick, in its own unit."""
        if self.pace is None:
            return self.value
        slowness = self.pace.slowness
        return self.value / slowness if self.at_most else self.value * slowness

    @property
    def verdict(self) -> str:
        if self.floor is None:
            return OK
        is_held = self.judged <= self.floor if self.at_most else self.judged >= self.floor
        if is_held:
            return OK
        return MISSED if self.pace is None or self.pace.is_steady else TOO_BUSY

    @property
    def passed(self) -> bool:
        return self.verdict != MISSED


def print_measurements(title: str, measurements: list[Measurement], console: Console) -> None:
    table = Table(title=title, title_justify="left", title_style="bold")
    for heading in ("measured", "value", "yardstick", "judged", "bound", "aim", ""):
        justify: JustifyMethod = "left" if heading == "measured" else "right"
        table.add_column(heading, justify=justify, no_wrap=heading != "measured")
    for m in measurements:
        sign = "<=" if m.at_most else ">="
        table.add_row(
            m.name,
            f"{m.value:.3g} {m.unit}",
            "" if m.pace is None else _describe(m.pace),
            "" if m.pace is None else f"{m.judged:.3g}",
            "" if m.floor is None else f"{sign} {m.floor:g}",
            "" if m.aim is None else f"{sign} {m.aim:g}",
            m.verdict if m.verdict == OK else f"[bold red]{m.verdict}[/]",
        )
    console.print(table)


def _describe(pace: Pace) -> str:
    """The yardstick's time by its quiet one, and its scatter."""
    return f"{pace.yardstick} x {pace.slowness:.2f} +{100 * pace.scatter:.0f} %"
