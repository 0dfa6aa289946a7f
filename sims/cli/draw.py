"""`parapod draw`: draws the system diagram of an experiment."""

import argparse
from pathlib import Path

from parapod.sims.cli.arguments import (
    HELD,
    add_scenario_arguments,
    check_outputs,
    count,
    load,
)

HELP = "draw the system diagram of an experiment"
DESCRIPTION = (
    "Draws the closed loop of an experiment: systems as blocks with named ports, inside their "
    "station and controller, data flowing from left to right. In an SVG the pointer tells where a "
    "wire begins and ends."
)
EXAMPLES = (
    "parapod draw level --out level.svg",
    "parapod draw chair-walk --backend kinematic --depth 1 --out chair.png",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_scenario_arguments(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        required=True,
        help="file (.svg, .png or .pdf; .dot and .gv for Graphviz's own language)",
    )
    parser.add_argument(
        "--depth",
        type=count,
        metavar="N",
        default=2,
        help="levels that are shown: 1 station and controller, 2 (default) what is in them, ...",
    )


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    check_outputs({"out": arguments.out})
    experiment, scenario = load(arguments)

    from parapod.sims.api import loop_of
    from parapod.sims.lab.bench import write_graphviz

    write_graphviz(arguments.out, loop_of(experiment, scenario), arguments.depth)
    print(f"wrote {arguments.out}")
    return HELD
