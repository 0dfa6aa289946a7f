"""`parapod bench-rt`: how punctually this computer runs the controller."""

import argparse
from pathlib import Path

from parapod.sims.cli.arguments import (
    HELD,
    UsageError,
    add_machine_option,
    check_outputs,
    machine_of,
)

HELP = "measure how punctually this computer runs the controller"
DESCRIPTION = (
    "Runs a machine's closed loop in real time at several rates, and in turns with "
    "it a loop that only wakes up. Prints how late ticks begin (period error), what they cost, "
    "and how late the machine wakes up by itself: a controller cannot be more punctual than that."
)
_BACKENDS = ("mock", "kinematic")  # never the hardware: the job moves the machine


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_machine_option(parser)
    parser.add_argument(
        "--rates",
        type=float,
        nargs="+",
        default=[100.0, 200.0, 500.0],
        metavar="HZ",
        help="of the loop; default 100 200 500",
    )
    parser.add_argument(
        "--seconds", type=float, default=10.0, metavar="S", help="at each rate; default 10"
    )
    parser.add_argument(
        "--backend", default="mock", choices=_BACKENDS, help="of the station; default mock"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to FILE")


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    for rate in arguments.rates:
        if not 20.0 <= rate <= 1000.0:
            raise UsageError(f"--rates {rate:g} is outside 20..1000 Hz")
    if not 1.0 <= arguments.seconds <= 3600.0:
        raise UsageError(f"--seconds {arguments.seconds:g} is outside 1..3600")
    check_outputs({"json": arguments.json})

    from rich.console import Console

    from parapod.sims.lab.discovery import find_experiment
    from parapod.sims.lab.files import write_json
    from parapod.sims.real_machine.punctuality import bench_real_time, print_punctuality

    experiment = find_experiment(arguments.name)
    scenario = experiment.schema(backend=arguments.backend)
    machine, scenario = machine_of(experiment, scenario)
    rates, seconds = arguments.rates, arguments.seconds
    results = bench_real_time(machine, scenario, rates, seconds, Console(stderr=True))
    print_punctuality(results, Console())
    if arguments.json is not None:
        write_json(arguments.json, {"rates": [result.as_json() for result in results]})
        print(f"wrote {arguments.json}")
    return HELD
