"""`parapod check`: self-test of the devices of one part of the machine."""

import argparse

from parapod.sims.cli.arguments import (
    BROKEN,
    HELD,
    UsageError,
    add_machine_option,
    add_scenario_options,
    agreed,
    load,
    machine_of,
)

HELP = "test the devices of one part of the machine"
DESCRIPTION = (
    "Configures the devices of one part, which refuses wrong addresses and wrong devices, reads "
    "them, and checks what they show. Nothing gets power unless --move is given: then one "
    "actuator moves there and back, and its sign and scale are checked."
)
EXAMPLES = (
    "parapod check imu --scenario lab.yaml",
    "parapod check legs --of chair-walk --move 1",
    "parapod check legs --move 1 --command 1 --scenario lab.yaml",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument(
        "part", metavar="PART", help="part of the machine, such as legs, wheels or imu"
    )
    add_machine_option(parser)
    add_scenario_options(parser)
    parser.add_argument(
        "--seconds", type=float, default=2.0, metavar="S", help="seconds to read; default 2"
    )
    parser.add_argument(
        "--move", type=int, metavar="N", help="move actuator N, counted from 1, there and back"
    )
    parser.add_argument(
        "--command",
        dest="size",
        type=float,
        metavar="X",
        help="command for --move: motor voltage in V, velocity of a wheel in rad/s or of a leg in "
        "m/s; default 1, 1 or 0.01",
    )
    parser.add_argument(
        "--for",
        dest="duration",
        type=float,
        default=1.0,
        metavar="S",
        help="seconds of each way of --move; default 1",
    )
    parser.add_argument("--yes", action="store_true", help="do not ask before --move")


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    if not 0.1 <= arguments.seconds <= 3600.0:
        raise UsageError(f"--seconds {arguments.seconds:g} is outside 0.1..3600")
    experiment, scenario = load(arguments)
    machine, scenario = machine_of(experiment, scenario)

    from rich.console import Console

    from parapod.sims.output.results import Result, print_table
    from parapod.sims.real_machine.self_test import Move, check_part

    move, part = None, arguments.part
    if arguments.move is not None:
        move = Move(arguments.move - 1, arguments.size, arguments.duration)
    question = f"{part} {arguments.move} will move. Is everybody clear of the machine?"

    def may_move() -> bool:
        return arguments.yes or agreed(question, "--move")

    metrics = check_part(machine, scenario, part, move, arguments.seconds, print, may_move)
    if not metrics and move is not None:
        print("nothing was moved")
        return BROKEN
    if not metrics:
        print(f"{part} measures nothing: that its devices answer is all that was checked")
        return HELD
    result = Result(f"check {part}", "hardware", scenario.seed, tuple(metrics))
    print_table(result, Console())
    return HELD if result.passed else BROKEN
