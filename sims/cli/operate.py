"""`parapod operate`: a person operates a machine, simulated or real, on a page."""

import argparse
from pathlib import Path

from parapod.sims.cli.arguments import (
    HELD,
    UsageError,
    add_scenario_arguments,
    check_outputs,
    load,
)

HELP = "operate a machine, simulated or real, on a page in the browser"
DESCRIPTION = (
    "Serves a page on which a person operates the machine, with the machine drawn as its sensors "
    "tell it, and pale what it is asked for. The machine begins when the page is opened; it holds "
    "when the page is closed or nothing is heard of it for 0.3 s."
)
EXAMPLES = (
    "parapod operate deploy",
    "parapod operate chair-walk",
    "parapod operate deploy --backend hardware --scenario lab.yaml --log operated.mcap",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_scenario_arguments(parser)
    parser.add_argument(
        "--host",
        default="localhost",
        metavar="ADDRESS",
        help="serve the page at this address of the computer, to browsers with the token in the "
        "page's address; default: to this computer alone, with a token too",
    )
    parser.add_argument(
        "--log", type=Path, metavar="FILE", help="write all signals of hardware, as MCAP"
    )


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    check_outputs({"log": arguments.log})
    experiment, scenario = load(arguments)
    if arguments.log is not None and scenario.backend != "hardware":
        raise UsageError(f"--log is of hardware; the backend is {scenario.backend}")

    from rich.console import Console

    from parapod.sims.lab.experiment import LoopExperiment
    from parapod.sims.lab.operate import operate
    from parapod.sims.output.options import RunOptions

    if not isinstance(experiment, LoopExperiment):
        raise UsageError(f"'{arguments.name}' has nothing that a person operates")
    options = RunOptions(log=arguments.log, console=Console(stderr=True))
    operate(experiment, scenario, options, arguments.host)
    return HELD
