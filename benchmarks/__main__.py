"""Speed, accuracy and endurance, measured.

A group prints a table: each figure beside its bound, and figures of speed beside a yardstick taken
in the same minute, see `benchmarks.yardstick`. Programs have arguments of their own.
"""

import argparse
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from rich.console import Console

from benchmarks import (
    accuracy,
    arm,
    centres,
    chair,
    deadlines,
    designs,
    endurance,
    engines,
    hardware,
    jobs,
    kinematics,
    loop,
    mechanisms,
    mutants,
    realtime,
    rows,
    scale,
    terrain,
)
from benchmarks.report import Measurement, make_console, print_measurements
from parapod.sims.output.figures import FORMATS

_GROUPS: dict[str, Callable[[Console], list[Measurement]]] = {
    "kinematics": lambda _: kinematics.run(),
    "mechanisms": lambda _: mechanisms.run(),
    "realtime": realtime.run,
    "rows": rows.run,
    "arm": arm.run,
    "accuracy": accuracy.run,
    "chair": chair.run,
    "centres": centres.run,
    "terrain": terrain.run,
    "designs": lambda _: designs.run(),
    "scale": scale.run,
    "endurance": endurance.run,
    "hardware": hardware.run,
    "deadlines": deadlines.run,
    "buses": deadlines.buses,
    "day": endurance.run_day,
}
# Run by their names alone: one takes a day, the other is a part of `deadlines`.
_NAMED = ("day", "buses")
_PROGRAMS: dict[str, Callable[[list[str]], int]] = {
    "engines": engines.main,
    "jobs": jobs.main,
    "loop": loop.main,
    "mutants": mutants.main,
}
_EPILOG = """
programs, each with a --help of its own:
  engines   Drake and MuJoCo: speed against accuracy
  jobs      jobs on emulated devices: how many end well
  loop      the tick of a loop: where its time goes
  mutants   single changes of the code: how many the tests notice
"""


def main(arguments: list[str]) -> int:
    if arguments and arguments[0] in _PROGRAMS:
        return _PROGRAMS[arguments[0]](arguments[1:])
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        usage="%(prog)s [--strict] [--out FILE] [GROUP ...]\n"
        "       %(prog)s PROGRAM [ARGUMENT ...]",
        description=__doc__,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "groups",
        nargs="*",
        metavar="GROUP",
        help=f"{', '.join(_GROUPS)}; all but {' and '.join(_NAMED)} without any",
    )
    parser.add_argument("--strict", action="store_true", help="exit with 1 if a bound is missed")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="picture of the closed loops of `accuracy`"
    )
    options = parser.parse_args(arguments)
    if options.out and options.out.suffix[1:] not in FORMATS:
        endings = ", ".join(f".{ending}" for ending in FORMATS)
        parser.exit(2, f"{options.out} is not a picture; its name ends in one of {endings}\n")
    if unknown := [name for name in options.groups if name not in _GROUPS]:
        admissible = ", ".join([*_GROUPS, *_PROGRAMS])
        parser.exit(2, f"there is no benchmark '{unknown[0]}'; there are: {admissible}\n")
    if options.out and options.groups and "accuracy" not in options.groups:
        parser.exit(2, "--out is a picture of the group accuracy, which is not asked for\n")
    groups = _GROUPS | {"accuracy": partial(accuracy.run, out=options.out)}
    console = make_console()
    failures: list[str] = []
    for name in options.groups or [name for name in _GROUPS if name not in _NAMED]:
        console.print(f"[bold]{name}[/]")
        measured = groups[name](console)
        print_measurements(name, measured, console)
        failures += [measurement.name for measurement in measured if not measurement.passed]
    if failures:
        console.print(f"missed: {', '.join(failures)}", highlight=False)
    return 1 if failures and options.strict else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
