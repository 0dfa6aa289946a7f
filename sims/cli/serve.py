"""`parapod serve`: a machine, simulated or real, on a bus."""

import argparse
import sys
from pathlib import Path

from parapod.sims.cli.arguments import (
    HELD,
    UsageError,
    add_scenario_arguments,
    check_outputs,
    load,
    machine_of,
)
from parapod.systems.hardware.buses.address import KINDS

HELP = "put a machine on a bus, for a controller in another program"
DESCRIPTION = (
    "Publishes what the machine measures, in real time, and takes the commands of another "
    "program. A part whose commands do not come any more is neutral, until its controller gives "
    "it up or has been silent for a second. Messages stay on this computer unless the address "
    "says otherwise."
)
EXAMPLES = (
    "parapod serve level --lcm",
    "parapod serve chair-walk --backend kinematic --lcm '#_LEFT'",
    "parapod serve level --ros2 '#left'",
    "parapod serve level --backend hardware --scenario lab.yaml --lcm --log served.mcap",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_scenario_arguments(parser)
    parser.add_argument(
        "--lcm",
        nargs="?",
        const="",
        metavar="ADDRESS",
        help="serve it on LCM, at an address such as 239.255.76.67:7667?ttl=0#_LEFT, whose end "
        "after # is put to the names of the channels; default: LCM's usual one, on this computer",
    )
    parser.add_argument(
        "--ros2",
        nargs="?",
        const="",
        metavar="ADDRESS",
        help="serve it on ROS 2, at an address such as 42?range=subnet#left: the domain, whether "
        "other computers are to find it, and the namespace; default: the domain of the "
        "environment, on this computer",
    )
    parser.add_argument(
        "--for", dest="duration", type=float, metavar="S", help="end after this number of seconds"
    )
    parser.add_argument("--log", type=Path, metavar="FILE", help="write all signals, as MCAP")


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    import math

    check_outputs({"log": arguments.log})
    places = {kind: getattr(arguments, kind) for kind in KINDS}
    addresses = [f"{kind}://{place}" for kind, place in places.items() if place is not None]
    if len(addresses) != 1:
        raise UsageError(f"name one bus: {' or '.join(f'--{kind}' for kind in KINDS)}")
    experiment, scenario = load(arguments)
    machine, scenario = machine_of(experiment, scenario)

    from rich.console import Console

    from parapod.sims.output.options import RunOptions
    from parapod.sims.real_machine.serve import serve

    options = RunOptions(log=arguments.log, console=Console(stderr=True))
    duration = math.inf if arguments.duration is None else arguments.duration
    try:
        serve(machine, scenario, addresses[0], options, duration)
    except KeyboardInterrupt:
        print("the machine is off the bus", file=sys.stderr)  # as it is meant to
    return HELD
