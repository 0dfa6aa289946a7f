"""`parapod scenario`: print the scenario of an experiment, with explanations."""

import argparse
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

from parapod.sims.commands.arguments import HELD, add_scenario_arguments, load

if TYPE_CHECKING:  # Help and errors must not wait for Drake.
    from parapod.sims.experiment import Entry

HELP = "print the scenario of an experiment as YAML"
DESCRIPTION = (
    "Prints the scenario that `parapod run` would use with the same arguments, and explains every "
    "key in it."
)

_HINT = "A file of your own needs only the keys that differ."

add_arguments = add_scenario_arguments


def execute(arguments: argparse.Namespace, entries: "Sequence[Entry]") -> int:
    """Run the command; return the exit code."""
    from parapod.systems.core.scenario_file import dump_scenario

    experiment, scenario = load(arguments, entries)
    title = f"parapod run {experiment.name}: {experiment.summary} {_HINT}"
    print(textwrap.fill(title, 99, initial_indent="# ", subsequent_indent="# "))
    print(f"#\n{dump_scenario(scenario, comments=True)}", end="")
    return HELD
