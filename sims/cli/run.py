"""`parapod run`: runs an experiment, shows what it measured, and checks the bounds."""

import argparse
import sys
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from parapod.sims.cli.arguments import (
    BROKEN,
    HELD,
    UsageError,
    add_print_options,
    add_scenario_arguments,
    check_outputs,
    count,
    load,
    print_of,
)
from parapod.systems.core.errors import OutputError

if TYPE_CHECKING:
    from parapod.sims.output.results import Result

HELP = "run an experiment and check its bounds"
DESCRIPTION = "Runs an experiment, prints what it measured, and checks the bounds."
EXAMPLES = (
    "parapod run level --meshcat",
    "parapod run level --set ground.pitch_deg=4 seed=3 --json level.json",
    "parapod run chair-walk --set passenger.mass_kg=70 --html walk.html",
    "parapod run level --backend hardware --scenario lab.yaml --log first.mcap",
)
_OUTPUTS = {
    "html": "a recording that plays in a browser",
    "json": "the metrics in JSON",
    "log": "the signals (.npz for numpy, .mcap, .csv; of hardware .mcap)",
    "graphviz": "the system diagram (.dot, .svg, .png or .pdf)",
    "video": "a film of the machine in real time (.mp4, .webm or .gif)",
}
# Options that show a single run.
_ALONE = ("meshcat", "html", "log", "graphviz", "video", "figures", "plot")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_scenario_arguments(parser)
    parser.add_argument(
        "--meshcat", action="store_true", help="show the machine in a browser, at real time"
    )
    parser.add_argument(
        "--no-live",
        dest="live",
        action="store_false",
        help="end a --meshcat run with the scripted job instead of staying for the sliders",
    )
    parser.add_argument(
        "--figures",
        type=Path,
        metavar="DIR",
        help="draw the figures into DIR",
    )
    add_print_options(parser, has_format=True)
    parser.add_argument(
        "--plot", action="store_true", help="open a page with the figures and metrics in a browser"
    )
    parser.add_argument(
        "--seeds",
        type=count,
        metavar="N",
        help="run N seeds, from the scenario's on, and show smallest, middle and largest values",
    )
    for option, what in _OUTPUTS.items():
        parser.add_argument(f"--{option}", type=Path, metavar="FILE", help=f"write {what} to FILE")


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    files = {option: getattr(arguments, option) for option in _OUTPUTS}
    check_outputs(files, {"figures": arguments.figures})
    print_of(arguments, arguments.figure_format)  # refused before the run
    experiment, scenario = load(arguments)
    if arguments.seeds is not None:
        return _run_seeds(scenario, arguments)

    from rich.console import Console

    from parapod.sims.output.options import RunOptions

    console = Console(stderr=True)
    with ExitStack() as stack:
        log = arguments.log
        if arguments.video is not None:
            from parapod.sims.replay.film import check_video, write_video

            check_video(arguments.video)
            if not hasattr(experiment, "logged"):
                raise OutputError(f"--video has nothing to film of '{experiment.name}'")
            if log is None:
                folder = stack.enter_context(TemporaryDirectory(prefix="parapod-"))
                suffix = "mcap" if scenario.backend == "hardware" else "npz"
                log = Path(folder) / f"{experiment.name}.{suffix}"
        options = RunOptions(
            meshcat=arguments.meshcat,
            live=arguments.live,
            html=arguments.html,
            log=log,
            graphviz=arguments.graphviz,
            console=console,
        )
        result = experiment.execute(scenario, options)
        try:
            if arguments.video is not None:
                write_video(log, arguments.video, console)
        finally:
            _show(result, arguments)
    if arguments.plot:
        _open(result)
    if result.afterwards is not None:
        result.afterwards()
    return HELD if result.passed else BROKEN


def _show(result: "Result", arguments: argparse.Namespace) -> None:
    """Writes and prints a result."""
    from rich.console import Console

    from parapod.sims.output.atomic import write_json
    from parapod.sims.output.results import print_table

    figures: list[Path] = []
    form = print_of(arguments, arguments.figure_format)
    try:
        if arguments.json is not None:
            write_json(arguments.json, result.as_json())
        if arguments.figures is not None:
            from parapod.sims.output.figures import write_figures

            figures = write_figures(arguments.figures, result.figures, form)
    finally:
        # Even if the disk is full by now: the run may have been long.
        print_table(result, Console())
        for path in (*(getattr(arguments, option) for option in _OUTPUTS), *figures):
            if path is not None and path.is_file():
                print(f"wrote {path}")
        sys.stdout.flush()


def _open(result: "Result") -> None:
    """Opens a page of its own, which stays where temporary files are."""
    import tempfile
    import webbrowser

    from parapod.sims.lab.pages import result_page

    begins = f"parapod-{result.experiment}-"
    with tempfile.NamedTemporaryFile("w", prefix=begins, suffix=".html", delete=False) as page:
        page.write(result_page(result))
    print(f"wrote {page.name}", flush=True)
    webbrowser.open(Path(page.name).as_uri())


def _run_seeds(scenario: Any, arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from parapod.sims.output.atomic import write_json
    from parapod.sims.study.seeds import run_seeds
    from parapod.sims.study.summary import print_summary

    for option in _ALONE:
        if getattr(arguments, option):
            raise UsageError(f"--{option} shows a single run and does not go with --seeds")
    if scenario.backend == "hardware":
        raise UsageError("--seeds runs simulations; the backend is hardware")
    result = run_seeds(arguments.name, scenario, arguments.seeds, Console(stderr=True))
    print_summary(result.summary, Console())
    if arguments.json is not None:
        write_json(arguments.json, result.summary.as_json())
        print(f"wrote {arguments.json}")
    return HELD if result.summary.passed == arguments.seeds else BROKEN
