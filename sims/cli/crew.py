"""Options of commands with many workers: how many, where, and their file."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parapod.sims.cli.arguments import UsageError, add_print_options, count

if TYPE_CHECKING:
    from parapod.sims.design.search import Search
    from parapod.sims.lab.work import Crew
    from parapod.sims.study.records import Records
    from parapod.sims.study.study import Study


def add_crew_options(parser: argparse.ArgumentParser, what: str) -> None:
    """Adds the options, and those of figures.

    Args:
        parser: parser of the command.
        what: pieces of its work, such as "runs".
    """
    parser.add_argument(
        "--workers", type=count, metavar="N", help="processes on this computer; default all cores"
    )
    parser.add_argument(
        "--cluster", metavar="ADDRESS", help="Dask scheduler whose workers do it instead"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help=f"append the {what} to FILE, a Parquet table"
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help=f"go on with FILE: do only the {what} that are missing",
    )
    parser.add_argument("--figures", type=Path, metavar="DIR", help="draw the figures into DIR")
    add_print_options(parser, has_format=True)


def check_crew_options(arguments: argparse.Namespace) -> None:
    """Refuses options that do not go together.

    Raises:
        UsageError: names them.
        OutputError: `--out` does not name a table that could be written.
    """
    from parapod.sims.study.file import check_path

    if arguments.drivers is not None:
        raise UsageError("--drivers is for hardware; a study simulates")
    if arguments.resume and arguments.out is None:
        raise UsageError("--resume goes on with a file: name it with --out")
    if arguments.workers and arguments.cluster:
        raise UsageError("--workers are processes of this computer, --cluster has its own")
    if arguments.out is not None:
        check_path(arguments.out)


def carry_out(
    work: "Study | Search",
    arguments: argparse.Namespace,
    what: str,
    records: "Records",
    **settings: Any,
) -> None:
    """Carries out a study or a search; says what its file has where that comes to no end.

    Args:
        work: the study or search.
        arguments: arguments of a command with `add_crew_options`.
        what: pieces of the work, such as "runs".
        records: empty ones, which take what comes out.
        settings: further ones of its `carry_out`.
    """
    from rich.console import Console

    is_over = False
    try:
        with _crew(arguments) as crew:
            console = Console(stderr=True)
            work.carry_out(crew, records, console, arguments.out, arguments.resume, **settings)
        is_over = True
    finally:
        if not is_over and arguments.out is not None and records.done.any():
            progress = (
                f"{records.done.sum()} of {work.sampling.runs} {what} are in {arguments.out}"
            )
            print(f"parapod: {progress}; --resume does the rest", file=sys.stderr)


def _crew(arguments: argparse.Namespace) -> "Crew":
    if arguments.cluster is not None:
        from parapod.sims.study.cluster import ClusterCrew

        return ClusterCrew(arguments.cluster)
    from parapod.sims.lab.work import LocalCrew

    return LocalCrew(arguments.workers)
