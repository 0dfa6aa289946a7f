"""`parapod study`: runs an experiment over grounds, seeds and tolerances, on all cores."""

import argparse
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from parapod.sims.cli.arguments import (
    BROKEN,
    HELD,
    UsageError,
    add_scenario_arguments,
    check_outputs,
    count,
    load,
    print_of,
    rows,
)
from parapod.sims.cli.crew import add_crew_options, carry_out, check_crew_options

if TYPE_CHECKING:
    from parapod.sims.study.result import StudyResult

HELP = "run an experiment over values of some keys, on all cores"
DESCRIPTION = (
    "Runs an experiment over the values of some keys of its scenario, and shows how its metrics "
    "spread, what each key contributes, and where the bounds are held.\n\n"
    "Values: FIRST:LAST:NUMBER, FIRST:END (whole numbers below END; of other keys all between), "
    "VALUE,VALUE,... or, in quotes, 'normal(MEAN, DEVIATION)', 'uniform(LOW, HIGH)', "
    "'loguniform(LOW, HIGH)'."
)
EXAMPLES = (
    "parapod study level --backend kinematic --vary ground.pitch_deg=-5:5:11 seed=0:20",
    "parapod study level --vary plant.length_error_mm=0:0.3 seed=0:200 --sampling sobol "
    "--runs 2000 --out study.parquet --html study.html",
    "parapod study level --vary seed=0:1000 --out seeds.parquet --cluster tcp://10.0.0.1:8786",
)
_OUTPUTS = {
    "html": "a page with the summary and the figures",
    "json": "the summary in JSON",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_scenario_arguments(parser)
    parser.add_argument(
        "--vary",
        nargs="+",
        action="extend",
        default=[],
        metavar="KEY=VALUES",
        help="vary keys, as in ground.pitch_deg=-5:5:11 or seed=0:200; may be repeated",
    )
    parser.add_argument(
        "--sampling",
        choices=("grid", "latin", "sobol"),
        default="grid",
        help="grid: every combination (default); latin: a Latin hypercube; sobol: the design that "
        "tells what each variable contributes",
    )
    parser.add_argument(
        "--runs", type=count, metavar="N", help="number of runs; a grid has its own"
    )
    parser.add_argument(
        "--sampling-seed", type=int, default=0, metavar="N", help="seed of the sampling; default 0"
    )
    parser.add_argument(
        "--rows",
        type=rows,
        metavar="N",
        help="simulate up to N runs together, as rows of the same arithmetic; 0: each alone; "
        "default auto: as many as are fast, within 640 MiB a worker",
    )
    parser.add_argument(
        "--watch", action="store_true", help="show the page in a browser while the study runs"
    )
    add_crew_options(parser, "runs")
    for option, what in _OUTPUTS.items():
        parser.add_argument(f"--{option}", type=Path, metavar="FILE", help=f"write {what} to FILE")


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    files = {option: getattr(arguments, option) for option in (*_OUTPUTS, "out")}
    check_outputs(files, {"figures": arguments.figures})
    print_of(arguments, arguments.figure_format)  # refused before the study
    check_crew_options(arguments)
    _, scenario = load(arguments)

    from rich.console import Console

    from parapod.sims.study.records import Records
    from parapod.sims.study.result import StudyResult
    from parapod.sims.study.study import Study
    from parapod.sims.study.variables import split_variable
    from parapod.sims.study.watch import watched

    variables = [split_variable(text) for text in arguments.vary]
    for key, _ in variables:
        if [other for other, _ in variables].count(key) > 1:
            raise UsageError(f"--vary gives {key} twice")
    study = Study.make(
        arguments.name,
        scenario,
        dict(variables),
        arguments.sampling,
        arguments.runs,
        arguments.sampling_seed,
    )
    records = Records(study.sampling)
    page = watched(study, records, Console(stderr=True)) if arguments.watch else nullcontext()
    with page as look:
        carry_out(study, arguments, "runs", records, rows=arguments.rows, look=look)
        return _show(StudyResult(study, records), arguments)


def _show(result: "StudyResult", arguments: argparse.Namespace) -> int:
    """Prints and writes what came out; returns the exit code."""
    from rich.console import Console

    from parapod.sims.output.atomic import atomic_output, write_json
    from parapod.sims.output.figures import write_figures
    from parapod.sims.study.page import make_page
    from parapod.sims.study.summary import print_summary

    form = print_of(arguments, arguments.figure_format)
    written = [] if arguments.out is None else [arguments.out]
    try:
        if arguments.json is not None:
            write_json(arguments.json, result.summary.as_json())
            written.append(arguments.json)
        if arguments.html is not None:
            with atomic_output(arguments.html) as temporary:
                temporary.write_text(
                    make_page(result.study, result.summary, result.figures), encoding="utf-8"
                )
            written.append(arguments.html)
        if arguments.figures is not None:
            written += write_figures(arguments.figures, result.figures, form)
    finally:
        # Even if the disk is full by now: the study may have been long.
        print_summary(result.summary, Console())
        for path in written:
            print(f"wrote {path}")
        sys.stdout.flush()
    return HELD if result.summary.passed == result.study.sampling.runs else BROKEN
