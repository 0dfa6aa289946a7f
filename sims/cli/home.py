"""`parapod home`: the axes of one part of the real machine find their reference."""

import argparse

from parapod.sims.cli.arguments import (
    BROKEN,
    HELD,
    add_machine_option,
    add_scenario_options,
    agreed,
    load,
    machine_of,
)

HELP = "lead the actuators of one part to their reference"
DESCRIPTION = (
    "Leads every actuator of one part slowly to the end of its stroke, where a switch or the end "
    "itself tells its position, checks what was found, and writes it into the file with which the "
    "next programs begin. A reference that the checks contradict is refused."
)
EXAMPLES = (
    "parapod home --scenario lab.yaml",
    "parapod home --of chair-walk --scenario chair.yaml",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument(
        "part", metavar="PART", nargs="?", default="legs", help="part of the machine; default legs"
    )
    add_machine_option(parser)
    add_scenario_options(parser)
    parser.add_argument("--yes", action="store_true", help="do not ask before anything moves")


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    experiment, scenario = load(arguments)
    machine, scenario = machine_of(experiment, scenario)

    from rich.console import Console

    from parapod.sims.output.results import Result, print_table
    from parapod.sims.real_machine.homing import home_part

    part = arguments.part
    homing = machine.real.homings.get(part)
    if homing is not None and not arguments.yes:
        question = f"{part} will move. {machine.title.capitalize()}: {homing.prepare}?"
        if not agreed(question, "homing"):
            print("nothing was moved")
            return BROKEN
    metrics = home_part(machine, scenario, part, print)
    result = Result(f"home {part}", "hardware", scenario.seed, tuple(metrics))
    print_table(result, Console())
    return HELD if result.passed else BROKEN
