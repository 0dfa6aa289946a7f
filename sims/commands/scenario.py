"""`parapod scenario`: prints the scenario of an experiment."""

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from parapod.sims.commands.arguments import HELD, add_scenario_arguments, load

if TYPE_CHECKING:  # Help and errors must not wait for Drake.
    from parapod.sims.experiment import Entry

HELP = "print the scenario of an experiment as YAML"
DESCRIPTION = "Prints the scenario that `parapod run` would use with the same arguments."

add_arguments = add_scenario_arguments


def execute(arguments: argparse.Namespace, entries: "Sequence[Entry]") -> int:
    """Runs the command; returns the exit code."""
    from parapod.systems.core.scenario_file import dump_scenario

    print(dump_scenario(load(arguments, entries)[1]), end="")
    return HELD
