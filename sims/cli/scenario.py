"""`parapod scenario`: prints the scenario of an experiment."""

import argparse

from parapod.sims.cli.arguments import HELD, add_scenario_arguments, load

HELP = "print the scenario of an experiment as YAML"
DESCRIPTION = "Prints the scenario that `parapod run` would use with the same arguments."

add_arguments = add_scenario_arguments


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    from parapod.diagrams.scenario import dump_scenario

    print(dump_scenario(load(arguments)[1]), end="")
    return HELD
