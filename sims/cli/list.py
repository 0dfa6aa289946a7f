"""`parapod list`: the experiments, by machine, with the time that they usually take."""

import argparse
import sys

from parapod.sims.cli.arguments import HELD

HELP = "list the experiments"
DESCRIPTION = "Lists the experiments by machine, with the time that a run usually takes."
EXAMPLES = ("parapod list",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command has none."""


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    from rich.console import Console
    from rich.padding import Padding
    from rich.table import Table
    from rich.text import Text

    from parapod.sims.lab.discovery import Entry, list_entries
    from parapod.systems.core.errors import ParapodError

    groups: dict[str, list[tuple[Entry, str, str]]] = {}
    problems: list[str] = []
    for entry in list_entries():
        try:
            listed = entry, entry.summary, entry.takes
            _ = entry.switches  # read by every command, which cannot say that it is broken
            groups.setdefault(entry.group, []).append(listed)
        except ParapodError as error:
            problems.append(str(error))
    console = Console()
    width = max((len(entry.name) for group in groups.values() for entry, *_ in group), default=0)
    for title, members in groups.items():
        console.print(Text(title, style="bold"))
        table = Table.grid(padding=(0, 2))
        table.add_column(no_wrap=True, min_width=width)
        table.add_column(ratio=1)
        table.add_column(justify="right", no_wrap=True)
        for entry, summary, takes in members:
            table.add_row(Text(entry.name, style="cyan"), Text(summary), Text(takes, style="dim"))
        console.print(Padding(table, (0, 0, 0, 2)))
    for problem in problems:
        print(f"parapod: {problem}", file=sys.stderr)
    return HELD
