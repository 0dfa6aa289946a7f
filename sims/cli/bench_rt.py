"""`parapod bench-rt`: how punctually this computer runs the controller."""

import argparse
from pathlib import Path

from parapod.sims.cli.arguments import (
    HELD,
    UsageError,
    add_bus_options,
    add_machine_option,
    check_outputs,
    machine_of,
)

HELP = "measure how punctually this computer runs the controller"
DESCRIPTION = (
    "Runs a machine's closed loop in real time at several rates, and in turns with "
    "it a loop that only wakes up. Prints how late ticks begin (period error), what they cost, "
    "and how late the machine wakes up by itself: a controller cannot be more punctual than that. "
    "With --backend hardware the controller drives emulated devices, in processes that the "
    "command begins and ends itself; no other device is opened."
)
EXAMPLES = (
    "parapod bench-rt",
    "parapod bench-rt --of chair-walk --rates 100 --json punctual.json",
    "parapod bench-rt --backend hardware --log --settings",
    "parapod bench-rt --backend hardware --ros2",
)
_BACKENDS = ("mock", "kinematic", "hardware")
_RATES = (100.0, 200.0, 500.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_machine_option(parser)
    parser.add_argument(
        "--rates",
        type=float,
        nargs="+",
        metavar="HZ",
        help="rates of the loop; default 100 200 500; on devices that of the scenario",
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=10.0,
        metavar="S",
        help="at each rate, and for each setting; default 10",
    )
    parser.add_argument(
        "--backend",
        default="mock",
        choices=_BACKENDS,
        help="backend of the station; hardware: emulated devices of its own; default mock",
    )
    add_bus_options(parser, "drive all parts behind")
    parser.add_argument(
        "--log", action="store_true", help="measure with a log of all ports and without, in turns"
    )
    parser.add_argument(
        "--settings",
        action="store_true",
        help="under ordinary scheduling, SCHED_FIFO, mlockall, affinity to one core, and all "
        "three, in turns",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to FILE")


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    for rate in arguments.rates or ():
        if not 20.0 <= rate <= 1000.0:
            raise UsageError(f"--rates {rate:g} is outside 20..1000 Hz")
    if not 1.0 <= arguments.seconds <= 3600.0:
        raise UsageError(f"--seconds {arguments.seconds:g} is outside 1..3600")
    check_outputs({"json": arguments.json})

    from rich.console import Console

    from parapod.sims.lab.discovery import find_experiment
    from parapod.sims.output.atomic import write_json
    from parapod.sims.real_machine.computer import (
        print_computer,
        this_computer,
        watched_throttling,
    )
    from parapod.sims.real_machine.deadlines import compare_settings, print_settings, settings_of
    from parapod.sims.real_machine.punctuality import measure_punctuality, print_punctuality

    experiment = find_experiment(arguments.name)
    scenario = experiment.schema(backend=arguments.backend)
    machine, scenario = machine_of(experiment, scenario)
    if arguments.backend not in machine.backends:
        raise UsageError(
            f"--backend {arguments.backend}: {machine.title} has {', '.join(machine.backends)}"
        )
    on_devices = arguments.backend == "hardware"
    if arguments.bus and not on_devices:
        raise UsageError(f"--{arguments.bus} needs --backend hardware, whose parts it drives")
    if arguments.bus:
        from parapod.diagrams.drivers.bus import parts_on_bus

        scenario.hardware.drivers = parts_on_bus(machine.for_scenario(scenario), arguments.bus)
    usual = [1.0 / scenario.control.period] if on_devices else _RATES
    rates, seconds = arguments.rates or usual, arguments.seconds
    screen, aside = Console(), Console(stderr=True)
    computer = this_computer()
    print_computer(computer, screen)
    report: dict[str, object] = {"computer": computer.as_json()}
    with watched_throttling(computer) as throttling:
        if on_devices or arguments.settings or arguments.log:
            settings = settings_of(arguments.settings, arguments.log)
            measured = compare_settings(
                machine, machine.experiment, scenario, rates, seconds, settings, aside
            )
            report["settings"] = [one.as_json() for one in measured]
            print_settings(measured, screen)
        else:
            results = measure_punctuality(machine, scenario, rates, seconds, aside)
            report["rates"] = [result.as_json() for result in results]
            print_punctuality(results, screen)
    report["throttling"] = throttling.as_json()
    screen.print(f"real-time programs: {throttling.words}", markup=False, highlight=False)
    if arguments.json is not None:
        write_json(arguments.json, report)
        print(f"wrote {arguments.json}")
    return HELD
