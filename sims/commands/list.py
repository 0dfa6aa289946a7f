"""`parapod list`: the experiments that there are."""

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from parapod.sims.commands.arguments import HELD

if TYPE_CHECKING:  # Help and errors must not wait for Drake.
    from parapod.sims.experiment import Entry

HELP = "list the experiments"
DESCRIPTION = "Lists the experiments."


def add_arguments(parser: argparse.ArgumentParser, entries: "Sequence[Entry]") -> None:
    """The command has none."""


def execute(arguments: argparse.Namespace, entries: "Sequence[Entry]") -> int:
    """Runs the command; returns the exit code."""
    width = max((len(entry.name) for entry in entries), default=0)
    for entry in entries:
        print(f"{entry.name:<{width}}  {entry.summary}")
    return HELD
