"""`parapod sheet`: the data sheet of a machine as it is set."""

import argparse
from pathlib import Path
from typing import Any

from parapod.sims.cli.arguments import (
    HELD,
    UsageError,
    add_scenario_options,
    check_outputs,
    finite,
    load,
)
from parapod.sims.lab.discovery import find_entry

HELP = "data sheet of a machine: sizes, masses, workspace, forces, stiffness"
DESCRIPTION = (
    "Prints the data sheet of a machine as a scenario sets it, from closed forms: nothing is "
    "simulated. --html writes a page with dimensioned drawings, --json all numbers with their "
    "units. Any entry can be an objective or a constraint of `parapod design`."
)
EXAMPLES = (
    "parapod sheet level --html sheet.html",
    "parapod sheet level --machine my_machine.yaml --json sheet.json",
    "parapod sheet level --wrench 0 80 -200 0 0 0",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument(
        "name",
        metavar="EXPERIMENT",
        nargs="?",
        default="level",
        help="an experiment of the machine; default level",
    )
    add_scenario_options(parser)
    parser.add_argument(
        "--wrench",
        type=finite,
        nargs=6,
        metavar=("FX", "FY", "FZ", "MX", "MY", "MZ"),
        help="force [N] and moment [N m] at the tool or the seat, which deflect it",
    )
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a page to FILE")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers to FILE")


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    check_outputs({"html": arguments.html, "json": arguments.json})
    if arguments.backend is None and "kinematic" in find_entry(arguments.name).load().backends:
        arguments.backend = "kinematic"
    experiment, scenario = load(arguments)

    from rich.console import Console

    from parapod.diagrams.designs import check_design
    from parapod.sims.output.atomic import atomic_output, write_json
    from parapod.sims.sheet.page import make_page, print_sheet
    from parapod.sims.sheet.sheet import find_sheet

    machine: Any = getattr(experiment, "machine", None)
    if machine is None:
        raise UsageError(f"'{experiment.name}' runs no machine that has a data sheet")
    settings = experiment.machine_scenario(scenario)
    check_design(settings.machine)
    sheet = find_sheet(machine.name)(settings, arguments.wrench and tuple(arguments.wrench))
    title = f"{machine.title[:1].upper()}{machine.title[1:]}: data sheet"
    print_sheet(sheet, title, Console())
    if arguments.json is not None:
        write_json(arguments.json, {"machine": machine.name, **sheet.as_json()})
        print(f"wrote {arguments.json}")
    if arguments.html is not None:
        from parapod.sims.sheet.drawing import drawings, outlines_of

        outlines = outlines_of(experiment, scenario, sheet.signals())
        subtitle = f"As `{experiment.name}` has it."
        if arguments.machine is not None:
            subtitle = f"As {arguments.machine.name} sets it."
        page = make_page(
            sheet, title, subtitle, drawings(outlines, sheet.dimensions()), settings.machine
        )
        with atomic_output(arguments.html) as temporary:
            temporary.write_text(page)
        print(f"wrote {arguments.html}")
    return HELD
