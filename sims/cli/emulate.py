"""`parapod emulate`: the simulated machine behind emulated devices, for another program."""

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from parapod.sims.cli.arguments import (
    HELD,
    add_bus_options,
    add_scenario_arguments,
    check_outputs,
    load,
    machine_of,
)

# Parts of a scenario that are behind the devices, and what ends their names.
_BEHIND, _KEY = ("backend", "plant", "faults"), re.compile("[.=]")
_SLOWEST = 0.01  # rate: a job of half a minute takes an hour [-]

HELP = "put the simulated machine behind emulated devices"
DESCRIPTION = (
    "Simulates the machine in real time behind emulators of its devices, which speak the makers' "
    "protocols. Another program then runs `parapod run NAME --backend hardware` as on the real "
    "machine. Lines on standard input, PART KIND, make a device misbehave, as in `imu garbage`, "
    "and `imu well` ends it; `emergency_stop pressed`, `supply lost` and `switches open` act on "
    "parts that are not devices; `measure` prints the machine's true state, as an instrument "
    "beside it would. The emulator ends with Ctrl-C, and with the program that began it; "
    "`setsid --fork parapod emulate NAME` lets it outlive a shell."
)
EXAMPLES = (
    "parapod emulate level, and in another terminal: parapod run level --backend hardware",
    "parapod emulate level --backend kinematic --fault '12 imu garbage'",
    "parapod emulate chair-walk --log emulated.mcap",
    "parapod emulate level --backend kinematic --ros2",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_scenario_arguments(parser)
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="'AT PART KIND'",
        help="make a device misbehave at a time in s, as in '12 imu garbage'; may be repeated",
    )
    parser.add_argument(
        "--rate",
        type=_rate,
        metavar="R",
        help="emulated seconds in one of the computer's, up to 1; without it, as fast as this "
        "computer is found to follow, in a time that waits for programs that are late; 1: by the "
        "computer's own clock, as beside real devices",
    )
    add_bus_options(parser, "serve all parts on")
    parser.add_argument(
        "--for", dest="duration", type=float, metavar="S", help="end after this number of seconds"
    )
    parser.add_argument(
        "--log", type=Path, metavar="FILE", help="write all signals, the true ones too, as MCAP"
    )


def _rate(text: str) -> float:
    """A rate that is given on the command line [-]."""
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not _SLOWEST <= rate <= 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a rate of {_SLOWEST:g}..1")
    return rate


def _repeated(arguments: argparse.Namespace, settings: Sequence[str]) -> list[str]:
    """Options of another program that is to have the same machine.

    Args:
        arguments: those of this command.
        settings: settings of the job on devices, before those of the command.
    """
    options = []
    for name in ("scenario", "machine", "drivers", "seed", "controller"):
        value = getattr(arguments, name)
        if value is not None:
            options += [f"--{name}", str(value)]
    own = [each for each in arguments.overrides if _KEY.split(each)[0] not in _BEHIND]
    changes = [*settings, *own]
    return options + ["--set", *changes] * bool(changes)


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    import math
    import os

    parent = os.getppid()  # before the imports, which take seconds
    check_outputs({"log": arguments.log})
    experiment, scenario = load(arguments)
    machine, scenario = machine_of(experiment, scenario)

    settings = list(experiment.on_devices)
    if arguments.bus:
        from parapod.diagrams.drivers.bus import PARTS, parts_on_bus

        scenario.hardware.drivers = parts_on_bus(machine.for_scenario(scenario), arguments.bus)
        tag = PARTS[arguments.bus].__name__
        tags = ", ".join(f"!{tag} {{part: {one.part}}}" for one in scenario.hardware.drivers)
        settings.append(f"hardware.drivers=[{tags}]")

    from parapod.sims.real_machine.disturbances import disturbable, parsed_fault
    from parapod.sims.real_machine.emulator import emulate
    from parapod.systems.hardware.signals import ended_by_signals, ended_with_parent

    parts = sorted({driver.part for driver in scenario.hardware.drivers})
    may = disturbable(machine, parts)
    requests = [parsed_fault(text, may) for text in arguments.fault]
    duration = math.inf if arguments.duration is None else arguments.duration
    try:
        with ended_by_signals(), ended_with_parent(parent):
            emulate(
                *(machine, scenario, requests, duration, arguments.log),
                experiment=arguments.name,
                options=_repeated(arguments, settings),
                rate=arguments.rate,
            )
    except KeyboardInterrupt:
        print("the emulator has ended", file=sys.stderr)  # as it is meant to
    return HELD
