"""`python -m benchmarks [--strict] [GROUP ...]`: kinematics, realtime, accuracy, .. (see _GROUPS).
`python -m benchmarks loop [EXPERIMENT [KEY=VALUE ..]]`: where the time of a loop's tick goes.
`python -m benchmarks engines [--help]`: Drake and MuJoCo, speed against accuracy.
`python -m benchmarks jobs [--help]`: how many jobs on emulated devices end well.
`python -m benchmarks mutants [--help]`: how many single changes of the code the tests notice.

Measures and prints: the groups that are named, or all but the day's run. With `--strict` a missed
bound is an exit code of 1; what a busy machine misses is no error. Figures of speed stand beside
a yardstick taken in the same minute, see `benchmarks.yardstick`.
"""

import sys

from rich.console import Console

from benchmarks import (
    accuracy,
    centers,
    chair,
    deadlines,
    endurance,
    engines,
    hardware,
    jobs,
    kinematics,
    loop,
    mutants,
    realtime,
    scale,
    terrain,
)
from benchmarks.report import Measurement, print_measurements

_GROUPS = (
    *("kinematics", "realtime", "accuracy", "chair", "centers", "terrain"),
    *("scale", "endurance", "hardware", "deadlines", "day"),
)
# Of tables that go into a file or a pipe [characters].
_FILE_WIDTH = 130
_DEFAULT = tuple(name for name in _GROUPS if name != "day")


def main(arguments: list[str]) -> int:
    if arguments[:1] == ["engines"]:
        return engines.main(arguments[1:])
    if arguments[:1] == ["jobs"]:
        return jobs.main(arguments[1:])
    if arguments[:1] == ["mutants"]:
        return mutants.main(arguments[1:])
    console = Console(width=None if sys.stdout.isatty() else _FILE_WIDTH)
    if arguments[:1] == ["loop"]:
        loop.run(console, arguments[1:])
        return 0
    names = [name for name in arguments if name != "--strict"]
    strict = len(names) < len(arguments)
    unknown = [name for name in names if name not in _GROUPS]
    if unknown:
        print(f"there is no benchmark '{unknown[0]}'; there are: {', '.join(_GROUPS)}")
        return 2
    results: list[Measurement] = []
    for name in names or _DEFAULT:
        console.print(f"[bold]{name}[/]")
        measured = {
            "kinematics": kinematics.run,
            "realtime": lambda: realtime.run(console),
            "accuracy": lambda: accuracy.run(console),
            "chair": lambda: chair.run(console),
            "centers": lambda: centers.run(console),
            "terrain": lambda: terrain.run(console),
            "scale": lambda: scale.run(console),
            "endurance": lambda: endurance.run(console),
            "hardware": lambda: hardware.run(console),
            "deadlines": lambda: deadlines.run(console),
            "day": lambda: endurance.run_day(console),
        }[name]()
        print_measurements(name, measured, console)
        results += measured
    missed = [m.name for m in results if not m.passed]
    if missed:
        console.print(f"missed: {', '.join(missed)}", highlight=False)
    return 1 if missed and strict else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
