"""`parapod replay`: shows a log in the browser, the machine and its signals."""

import argparse
import sys
from pathlib import Path

from parapod.sims.cli.arguments import HELD, UsageError, check_outputs, finite

HELP = "show a log in the browser: the machine as it moved, and plots"
DESCRIPTION = (
    "Shows any log that parapod has written, of a simulation or of a real machine: the machine as "
    "its signals show it, a slider of time, and plots below. With --against a second log is laid "
    "over it: its curves dashed, its machine translucent.\n\n"
    "Signals: NAME, NAME[0] or NAME[0:3]; several joined by + share a plot."
)
EXAMPLES = (
    "parapod run level --log level.npz; parapod replay level.npz",
    "parapod replay first.mcap --against level.npz --html both.html",
    "parapod replay level.npz --plot legs.extension 'truth.posture[0]+attitude_estimated[0]'",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_log_arguments(parser)
    parser.add_argument(
        "--plot",
        nargs="+",
        action="extend",
        default=[],
        metavar="SIGNAL",
        help="signals to plot; by default those that show most of the machine",
    )
    view_options = parser.add_mutually_exclusive_group()
    view_options.add_argument(
        "--meshcat", action="store_true", help="serve the page to a browser here (default)"
    )
    view_options.add_argument(
        "--html", type=Path, metavar="FILE", help="write the page to FILE, which needs no network"
    )
    view_options.add_argument(
        "--video",
        type=Path,
        metavar="FILE",
        help="film the machine, in real time, to FILE (.mp4, .webm or .gif); plots are left out",
    )


def add_log_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say which logs, and which part of them."""
    parser.add_argument("log", metavar="LOG", type=Path, help="a log (.npz, .mcap or .csv)")
    parser.add_argument(
        "--against", type=Path, metavar="OTHER", help="another log that is laid over it"
    )
    parser.add_argument(
        "--between",
        nargs=2,
        type=finite,
        metavar=("BEGIN", "END"),
        help="first and last time that is shown [s]",
    )


def between_of(arguments: argparse.Namespace) -> tuple[float, float] | None:
    """The times that are asked for [s]; None: all.

    Raises:
        UsageError: the end is not after the beginning.
    """
    if arguments.between is None:
        return None
    begin, end = arguments.between
    if end <= begin:
        raise UsageError(f"--between {begin:g} {end:g}: the end must be after the beginning")
    return begin, end


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    check_outputs({"html": arguments.html, "video": arguments.video})
    between = between_of(arguments)

    from rich.console import Console

    if arguments.video is not None:
        return _film(arguments, between)

    from parapod.sims.replay.drawing import record
    from parapod.sims.replay.page import make_page, span
    from parapod.sims.replay.replay import open_replays
    from parapod.systems.core.extras import need

    need("plotly.offline")
    console = Console(stderr=True)
    replay, other = open_replays(
        arguments.log, arguments.against, arguments.plot, console, between=between
    )
    both = [replay] if other is None else [replay, other]
    begin, _ = span([each.digest for each in both])
    scene = record(replay, other, begin, console)
    for remark in dict.fromkeys(text for each in both for text in each.remarks):
        print(f"parapod: {remark}", file=sys.stderr)
    page = make_page(replay, other, scene)
    if arguments.html is not None:
        from parapod.sims.output.atomic import atomic_output

        with atomic_output(arguments.html) as temporary:
            temporary.write_text(page, encoding="utf-8")
        print(f"wrote {arguments.html}")
        return HELD
    from parapod.sims.lab.serve import PageServer

    with PageServer(page) as server:
        print(f"{arguments.log.name} is shown at {server.url}; Ctrl-C ends", flush=True)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print()
    return HELD


def _film(arguments: argparse.Namespace, between: tuple[float, float] | None) -> int:
    from rich.console import Console

    from parapod.sims.replay.film import write_video

    for option in ("against", "plot"):
        if getattr(arguments, option):
            raise UsageError(f"--{option} does not go with --video, which films one machine")
    write_video(arguments.log, arguments.video, Console(stderr=True), between)
    print(f"wrote {arguments.video}")
    return HELD
