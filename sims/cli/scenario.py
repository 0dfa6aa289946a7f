"""`parapod scenario`: prints the scenario of an experiment."""

import argparse
import textwrap

from parapod.sims.cli.arguments import HELD, add_scenario_arguments, load

HELP = "print the scenario of an experiment as YAML"
DESCRIPTION = (
    "Prints the scenario that `parapod run` would use with the same arguments, and explains every "
    "key in it."
)
EXAMPLES = (
    "parapod scenario level > mine.yaml; parapod run level --scenario mine.yaml",
    "parapod scenario level --set ground.pitch_deg=4",
)

_HINT = "A file of your own needs only the keys that differ."

add_arguments = add_scenario_arguments


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    from parapod.sims.lab.discovery import find_entry
    from parapod.systems.core.scenario_file import dump_scenario

    _, scenario = load(arguments)
    summary = find_entry(arguments.name).summary
    title = f"parapod run {arguments.name}: {summary} {_HINT}"
    print(textwrap.fill(title, 99, initial_indent="# ", subsequent_indent="# "))
    print(f"#\n{dump_scenario(scenario, comments=True)}", end="")
    return HELD
