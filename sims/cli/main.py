"""The `parapod` command: list, show and run experiments, and report on all of them.

Exit codes: 0 all bounds held, 1 a bound is broken, 2 the user's mistake, 130 interrupted.
"""

import argparse
import gc
import os
import sys
import warnings
from collections.abc import Sequence
from functools import cache
from typing import Any

from parapod.sims.cli import (
    adopt,
    bench_rt,
    check,
    compare,
    convert,
    design,
    draw,
    emulate,
    export,
    home,
    operate,
    plot,
    pose,
    replay,
    report,
    run,
    scenario,
    serve,
    sheet,
    study,
)
from parapod.sims.cli import list as list_command
from parapod.sims.cli.arguments import HELD, INTERRUPTED, MISTAKE, Parser
from parapod.sims.lab.discovery import uncollected
from parapod.systems.core.errors import ParapodError

# In the order of help, tour and reference.
GROUPS: dict[str, dict[str, Any]] = {
    "run": {"list": list_command, "scenario": scenario, "run": run, "operate": operate},
    "look": {
        "pose": pose,
        "convert": convert,
        "replay": replay,
        "plot": plot,
        "draw": draw,
        "sheet": sheet,
        "export": export,
    },
    "study": {"design": design, "study": study, "compare": compare, "report": report},
    "real machine": {
        "emulate": emulate,
        "serve": serve,
        "check": check,
        "home": home,
        "adopt": adopt,
        "bench-rt": bench_rt,
    },
}
COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}
# One of each group.
_EXAMPLES = (run, replay, study, emulate)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command.

    Args:
        argv: the arguments; None for those of the process.

    Returns:
        The exit code.
    """
    if argv is None:
        warnings.showwarning = _warn
    try:
        return _run(argv)
    finally:
        if argv is None:
            # The process ends: looking through all that it holds once more takes 0.2 s.
            gc.freeze()


def _warn(message: Warning | str, *_where: object, **_options: object) -> None:
    _print_once(f"parapod: warning: {message}")


@cache
def _print_once(line: str) -> None:
    print(line, file=sys.stderr)


def _run(argv: Sequence[str] | None) -> int:
    try:
        with uncollected():
            parser = make_parser()
        arguments, rest = parser.parse_known_args(argv)
        if rest:
            is_key = any("=" in word and not word.startswith("-") for word in rest)
            hint = "; keys of a scenario follow --set" if is_key else ""
            parser.error(f"unrecognized arguments: {' '.join(rest)}{hint}")
        code = _dispatch(parser, arguments)
        sys.stdout.flush()
    except ParapodError as error:
        print(f"parapod: error: {error}", file=sys.stderr)
        return MISTAKE
    except KeyboardInterrupt:
        print("parapod: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader, such as head, has seen enough. Python must not try to flush again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return HELD
    except OSError as error:
        # Standard output cannot be written: a full disk, say.
        print(f"parapod: error: {error.strerror or error}", file=sys.stderr)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return MISTAKE
    return code


def make_parser() -> Parser:
    """The parser of all commands."""
    parser = Parser(
        prog="parapod",
        usage="%(prog)s [-h] [--version] COMMAND ...",
        description="Leg-supported parallel machines as Drake system diagrams.",
        commands={
            title: [(name, command.HELP) for name, command in group.items()]
            for title, group in GROUPS.items()
        },
        examples=[command.EXAMPLES[0] for command in _EXAMPLES],
    )
    parser.add_argument("--version", action="store_true", help="print the version and stop")
    # The parser lists them by groups.
    commands = parser.add_subparsers(
        dest="command", metavar="COMMAND", prog="parapod", help=argparse.SUPPRESS
    )
    for name, command in COMMANDS.items():
        added = commands.add_parser(
            name, description=command.DESCRIPTION, examples=command.EXAMPLES
        )
        command.add_arguments(added)
    return parser


def _dispatch(parser: Parser, arguments: argparse.Namespace) -> int:
    if arguments.version:
        from importlib.metadata import version

        print(f"parapod {version('parapod')}")
        return HELD
    if arguments.command is None:
        parser.print_help()
        return HELD
    return COMMANDS[arguments.command].execute(arguments)
