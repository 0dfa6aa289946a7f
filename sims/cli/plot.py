"""`parapod plot`: draws signals of a log into a file or a window."""

import argparse
import sys
from pathlib import Path

from parapod.sims.cli.arguments import HELD, add_print_options, check_outputs, print_of
from parapod.sims.cli.replay import add_log_arguments, between_of

HELP = "plot signals of a log, into a file or a window"
DESCRIPTION = (
    "Plots signals of any log that parapod has written, with their units, their limits where the "
    "machine or the experiment knows them, and phases shaded where the log has them. With "
    "--against a second log is laid over it, dashed.\n\n"
    "Signals: NAME, NAME[0] or NAME[0:3]; several joined by + share a plot."
)
EXAMPLES = (
    "parapod plot level.npz legs.extension legs.voltage",
    "parapod plot first.mcap legs.extension --against level.npz --out legs.svg",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_log_arguments(parser)
    parser.add_argument(
        "signals",
        nargs="*",
        metavar="SIGNAL",
        help="signals to plot; by default those that show most of the machine",
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="write FILE (.svg, .png, .pdf), open no window"
    )
    add_print_options(parser)


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    from parapod.sims.replay.figure import check_format, make_figure, show

    if arguments.out is not None:
        check_format(arguments.out)
    check_outputs({"out": arguments.out})
    between = between_of(arguments)

    from rich.console import Console

    from parapod.sims.replay.replay import open_replays

    replay, other = open_replays(
        arguments.log,
        arguments.against,
        arguments.signals,
        Console(stderr=True),
        between=between,
        is_drawn=False,
    )
    both = [replay] if other is None else [replay, other]
    for remark in dict.fromkeys(text for each in both for text in each.remarks):
        print(f"parapod: {remark}", file=sys.stderr)
    figure = make_figure(replay, other)
    if arguments.out is None:
        show(figure)
        return HELD
    from parapod.sims.output.atomic import atomic_output
    from parapod.sims.output.figures import render

    suffix = arguments.out.suffix.lower().removeprefix(".")
    content = render(figure, print_of(arguments, suffix))
    with atomic_output(arguments.out) as temporary:
        temporary.write_bytes(content)
    print(f"wrote {arguments.out}")
    return HELD
