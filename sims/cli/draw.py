"""`parapod draw`: draws the system diagram of an experiment."""

import argparse
from pathlib import Path

from parapod.sims.cli.arguments import (
    HELD,
    add_scenario_arguments,
    check_outputs,
    count,
    load,
    width,
)

HELP = "draw the system diagram of an experiment"
DESCRIPTION = (
    "Draws the closed loop of an experiment: systems as blocks, inside their station and "
    "controller. One level shows every port and wire; deeper levels show one wire from block to "
    "block, so that the letters can be read on a landscape page of A4, which the drawing fits. In "
    "an SVG the pointer shows which ports a wire connects."
)
EXAMPLES = (
    "parapod draw level --out level.svg",
    "parapod draw level --only controller --out controller.pdf",
    "parapod draw level --without scene_graph --ports --out level.svg",
    "parapod draw chair-walk --backend kinematic --depth 1 --width-mm 84 --out chair.png",
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
        help="levels that are shown: 1 (default of --only) station and controller, 2 (default) "
        "what is in them, ...",
    )
    parser.add_argument(
        "--only", metavar="PART", help="draw only this part, such as station or controller"
    )
    parser.add_argument(
        "--without",
        metavar="NAME",
        action="append",
        default=[],
        help="leave out a system or a part with its wires, and what is connected to nothing "
        "else; can be repeated",
    )
    parser.add_argument(
        "--ports",
        action=argparse.BooleanOptionalAction,
        help="show every port and wire, at the size that they need; default: only at --depth 1, "
        "and not larger than a page",
    )
    parser.add_argument(
        "--direction",
        choices=("right", "down"),
        help="way that data flow; default: right with ports, otherwise down",
    )
    parser.add_argument(
        "--width-mm",
        type=width,
        metavar="W",
        help="width of the drawing in print; letters grow and shrink with it",
    )


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    check_outputs({"out": arguments.out})
    experiment, scenario = load(arguments)

    from pydrake.systems.framework import Diagram

    from parapod.diagrams.block_diagram import BlockDiagram, part_of
    from parapod.sims.api import loop_of
    from parapod.sims.lab.runner import write_graphviz

    diagram: Diagram = loop_of(experiment, scenario)
    if arguments.only is not None:
        diagram = part_of(diagram, arguments.only)
    depth = arguments.depth or (2 if arguments.only is None else 1)
    drawing = BlockDiagram(
        diagram,
        depth,
        ports=depth == 1 if arguments.ports is None else arguments.ports,
        direction=arguments.direction,
        without=arguments.without,
        width_mm=arguments.width_mm,
        fits_page=not arguments.ports,
    )
    write_graphviz(arguments.out, drawing)
    print(f"wrote {arguments.out}")
    return HELD
