"""`parapod report`: runs all that the papers show, and writes it down in one HTML file."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from parapod.sims.cli.arguments import BROKEN, HELD, check_outputs, count

if TYPE_CHECKING:
    from parapod.sims.report.run import ChapterRun

HELP = "run everything that the papers show, into one HTML file"
DESCRIPTION = (
    "Runs every experiment, each with many seeds, and writes one HTML file that needs nothing "
    "else: every number that the papers print beside the same number here, every figure, and the "
    "papers' errata with what shows them."
)
EXAMPLES = (
    "parapod report --quick",
    "parapod report --out report.html",
)
_DEFAULT = Path("parapod-report.html")
_SEEDS = 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument(
        "--out",
        type=Path,
        default=_DEFAULT,
        metavar="FILE",
        help=f"the report; default {_DEFAULT}",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="one seed, shorter runs and larger time steps: a minute or two",
    )
    parser.add_argument(
        "--seeds",
        type=count,
        default=_SEEDS,
        metavar="N",
        help=f"seeds of each experiment that has any; by default {_SEEDS}",
    )


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    check_outputs({"out": arguments.out})

    from datetime import date

    from rich.console import Console

    from parapod.sims.output.atomic import atomic_output
    from parapod.sims.report.page import make_page
    from parapod.sims.report.run import list_chapters, run_chapter

    console, seeds = Console(stderr=True), 0 if arguments.quick else arguments.seeds
    runs = [run_chapter(chapter, arguments.quick, seeds, console) for chapter in list_chapters()]
    page = make_page(runs, arguments.quick, date.today().isoformat())
    with atomic_output(arguments.out) as temporary:
        temporary.write_text(page, encoding="utf-8")
    for run in runs:
        _print(run)
    print(f"wrote {arguments.out}")
    return HELD if all(run.passed for run in runs) else BROKEN


def _print(run: "ChapterRun") -> None:
    """The chapter in a few lines."""
    from parapod.sims.report.page import counts

    counts_by_word = ", ".join(f"{count} {word}" for word, count in counts(run).items())
    print(f"{run.chapter.title}: of {len(run.chapter.claims)} printed numbers {counts_by_word}")
    if run.problem:
        print(run.problem)
    for part in run.parts:
        if part.problem:
            print(f"{part.part.name}: {part.problem}")
        for result in part.results:
            for metric in result.broken:
                print(f"{part.part.name}, seed {result.seed}: broken: {metric}")
    for erratum, check in zip(run.chapter.errata, run.checks, strict=True):
        if not check.passed:
            print(f"{erratum.name} is not borne out: {check.shows}")
    if run.passed:
        print("all bounds held, all errata are borne out")
