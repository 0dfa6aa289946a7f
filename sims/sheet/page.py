"""A data sheet as one HTML file that needs nothing else, and as a table in a terminal."""

import math
from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from parapod.sims.lab.pages import render_page
from parapod.sims.output.figures import Figure
from parapod.sims.output.moment import moment
from parapod.sims.sheet.sheet import WRENCH, AnySheet
from parapod.systems.core.scenario_file import dump_scenario


def make_page(
    sheet: AnySheet,
    title: str,
    subtitle: str,
    drawings: Sequence[Figure],
    machine: Any,
) -> str:
    """The page.

    Args:
        sheet: the data sheet.
        title: its title.
        subtitle: a sentence below it.
        drawings: dimensioned drawings.
        machine: the part `machine` of its scenario.
    """
    return render_page(
        "parapod.sims.sheet",
        sheet=sheet,
        title=title,
        subtitle=subtitle,
        date=moment(),
        groups=sheet.by_group(),
        entries=sheet.entries(),
        values=sheet.values(),
        wrench=wrench_text(sheet),
        drawings=drawings,
        figures=list(sheet.figures()),
        tables=list(sheet.tables()),
        machine=dump_scenario(machine),
        shown=shown,
    )


def print_sheet(sheet: AnySheet, title: str, console: Console) -> None:
    """Prints all entries below their headings."""
    console.print(Text(title, style="bold"))
    grid = Grid(box=SIMPLE_HEAD)
    grid.add_column("entry", no_wrap=True)
    grid.add_column("value", justify="right", no_wrap=True)
    grid.add_column("meaning", style="dim")
    for group, entries in sheet.by_group().items():
        grid.add_row(Text(group, style="bold"))
        for name, entry in entries.items():
            value = f"{shown(sheet.value(name))} {entry.unit}".rstrip()
            grid.add_row(f"  {name}", value, entry.meaning)
    console.print(grid)
    console.print(Text(f"Wrench: {wrench_text(sheet)}."))


def shown(value: float) -> str:
    """A number to four digits; a dash where there is none."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.4g}"


def wrench_text(sheet: AnySheet) -> str:
    """The wrench in words."""
    units = ("N",) * 3 + ("N m",) * 3
    parts = zip(WRENCH, sheet.wrench, units, strict=True)
    return ", ".join(f"{name} {value:g} {unit}" for name, value, unit in parts if value) or "none"
