"""The `parapod` command: list, show and run experiments, and report on all of them.

Exit codes: 0 all bounds held, 1 a bound is broken, 2 the user's mistake, 130 interrupted.
"""

import argparse
import gc
import os
import sys
from collections.abc import Sequence

from parapod.sims.cli import (
    adopt,
    bench_rt,
    check,
    compare,
    draw,
    emulate,
    home,
    operate,
    plot,
    replay,
    report,
    run,
    scenario,
    study,
)
from parapod.sims.cli import list as list_command
from parapod.sims.cli.arguments import HELD, INTERRUPTED, MISTAKE, Parser
from parapod.sims.lab.discovery import uncollected
from parapod.systems.core.errors import ParapodError

COMMANDS = {
    "list": list_command,
    "run": run,
    "study": study,
    "replay": replay,
    "plot": plot,
    "operate": operate,
    "scenario": scenario,
    "compare": compare,
    "draw": draw,
    "adopt": adopt,
    "report": report,
    "emulate": emulate,
    "check": check,
    "home": home,
    "bench-rt": bench_rt,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command.

    Args:
        argv: the arguments; None for those of the process.

    Returns:
        The exit code.
    """
    try:
        return _run(argv)
    finally:
        if argv is None:
            # The process ends: looking through all that it holds once more takes 0.2 s.
            gc.freeze()


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
        description="Leg-supported parallel machines as Drake system diagrams.",
        examples=[command.EXAMPLES[-1] for command in COMMANDS.values()],
    )
    parser.add_argument("--version", action="store_true", help="print the version and stop")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands")
    for name, command in COMMANDS.items():
        added = commands.add_parser(
            name, help=command.HELP, description=command.DESCRIPTION, examples=command.EXAMPLES
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
