"""`python -m benchmarks faults [--help]`: fault matrix on emulated devices, and killed programs.

In each cell something breaks while a machine on emulated devices works: a device, its supply, a
switch, the disk of the log, or a program that is killed. The job must find it in time, name it,
end with another exit code than 0 and leave no outputs live.
"""

import argparse
import random
import re
import resource
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from benchmarks.emulated import Program, until, until_for_good
from benchmarks.kills import VICTIMS, killed
from benchmarks.machines import DEPLOY, LEVEL, LONGEST, WALK, Place, Running, Work, begun
from benchmarks.matrix import Matrix, Row
from benchmarks.report import Measurement
from parapod.systems.hardware.emulation.harness import KINDS

# Longest time until the legs have no power, or until commands are still where the supervisor
# holds [s]: a sensor that is stuck is found when the platform moves on, a device that comes and
# goes when it has been away for long enough, a switch that never closes at the end of the stroke.
_USUAL = 1.0
_LATER = {"stuck": 3.0, "intermittent": 2.5, "delayed": 1.5}
# What stands still for so long has stopped [s].
_STILL = 0.3
# A file may grow by so much more when its disk becomes full [bytes].
_ROOM = 4096
KILLS = 20


class Cell(NamedTuple):
    """One thing that is broken in a job.

    Attributes:
        part: part that is told to misbehave.
        kind: how.
        on: wire that must move before; "": the first of the job's.
        options: further arguments of the job.
        words: of the cell, in place of part and kind.
        bound: longest time for the answer [s]; None: as the kind has it.
        harmless: reason for which nobody need find it; "": somebody must.
    """

    part: str
    kind: str
    on: str = ""
    options: tuple[str, ...] = ()
    words: str = ""
    bound: float | None = None
    harmless: str = ""

    @property
    def name(self) -> str:
        return self.words or f"{self.part} {self.kind}"


# Emulated without its contact the button cuts the supply and tells nobody.
_UNSEEN = ("--set", 'hardware.drivers.0.stop_input=""')
_WHEELS = "nothing drives the wheels in this job: see deploy"
_STANDS = "the sensor is looked at while the platform stands or turns slowly: see deploy"
_SLOW = "the platform turns so slowly that samples of 0.1 or 0.2 s ago are as good"
_BRAKED = "no controller looks at wheel angles: the operator sees where the machine drives"
_CELLS: dict[Work, tuple[Cell, ...]] = {
    LEVEL: (
        *(Cell("legs", kind) for kind in KINDS),
        *(
            Cell("imu", kind, harmless=_STANDS if kind in ("slow", "delayed") else "")
            for kind in KINDS
        ),
        *(
            Cell(
                *("wheels", kind),
                harmless=_WHEELS if kind in ("stuck", "wrong", "slow", "delayed") else "",
            )
            for kind in KINDS
        ),
        *(Cell("drives", kind, bound=2.5) for kind in KINDS if kind != "unplugged"),
        Cell("supply", "lost"),
        Cell("emergency_stop", "pressed"),
        Cell("emergency_stop", "pressed", "", _UNSEEN, "emergency_stop pressed, no contact", 2.5),
    ),
    DEPLOY: (
        *(Cell("imu", kind, "legs.voltage", harmless=_SLOW) for kind in ("slow", "delayed")),
        Cell("imu", "wrong", "legs.voltage"),
        *(
            Cell("wheels", kind, "wheels.velocity_command", harmless=_BRAKED)
            for kind in ("stuck", "wrong", "slow", "delayed")
        ),
        Cell("switches", "closed", "wheels.velocity_command"),
        Cell("switches", "open", "legs.voltage", bound=60.0),
    ),
    WALK: (
        *(Cell("legs", kind) for kind in KINDS),
        Cell("supply", "lost"),
        Cell("emergency_stop", "pressed"),
    ),
}
# What may be found of a broken part.
_LEGS = "PXIe|EPOS2|leg|encoder|feet|supply|emergency_stop|following|current|no_support|posture"
_NAMED = {
    "legs": _LEGS,
    "drives": _LEGS,
    "supply": _LEGS,
    "emergency_stop": _LEGS,
    "imu": "ADIS|imu|gyro|accel|posture_mismatch|pushed_up",
    "wheels": "EPOS2",
    "switches": "switch|ground within its stroke",
}
_END = {"emergency_stop": "released", "supply": "back"}


def _broken(place: Place, cell: Cell) -> Row:
    """One job in which something breaks."""
    running, work = place.get(), place.work
    with running.working(*cell.options, on=cell.on) as program:
        running.machine.misbehave(cell.part, cell.kind)
        after = _answer(running, program)
        code = program.wait(LONGEST)
    is_live = running.stays_live
    running.machine.misbehave(cell.part, _END.get(cell.part, "well"))
    running.machine.remember(work.remembered)
    bound = _LATER.get(cell.kind, _USUAL) if cell.bound is None else cell.bound
    words = program.last_words if code else ""
    if code and not re.search(_NAMED[cell.part], words):
        remark = "another thing was found"
        return Row(work.name, cell.name, words, after, bound, code, is_live, remark, True)
    if cell.harmless:
        is_broken = code not in (0, 2)  # a bound of the job would be no harmless thing
        return Row(
            *(work.name, cell.name, words, None, None, code, is_live, cell.harmless, is_broken)
        )
    return Row(work.name, cell.name, words, after if code else None, bound, code, is_live)


def _answer(running: Running, program: Program) -> float:
    """Time until the machine has answered what has been broken [s]."""
    if running.work.ends:
        return until(lambda: program.has_ended or not running.has_power, LONGEST)
    return until_for_good(lambda: program.has_ended or not running.is_moving, _STILL, LONGEST)


def _full_disk(place: Place) -> Row:
    """A job whose log's disk becomes full."""
    running, work, cell = place.get(), place.work, "log, disk full"
    log = running.machine.folder / "full.mcap"
    with running.working("--log", str(log)) as program:
        writer = program.companion("parapod.sims.output.logs.live")
        size = log.stat().st_size + _ROOM
        try:
            resource.prlimit(writer, resource.RLIMIT_FSIZE, (size, size))
        except (AttributeError, OSError) as error:
            return Row(work.name, cell, remark=f"no limit can be set: {error}", is_skipped=True)
        after = until(lambda: bool(program.word("cannot write")), LONGEST)
        code = program.wait(LONGEST)
    is_live = running.stays_live
    running.machine.remember(work.remembered)
    return Row(work.name, cell, program.word("cannot write"), after, _USUAL, code, is_live)


@contextmanager
def _kept(place: Place) -> Iterator[Place]:
    """A place that is left at the end."""
    try:
        yield place
    finally:
        place.leave()


def measure(matrix: Matrix, works: Sequence[Work], kills: int, only: str = "") -> None:
    """Measures the cells of machines, and kills their programs.

    Args:
        matrix: takes the rows.
        works: the machines and their jobs.
        kills: number of kills of each program.
        only: part of the names of cells; others are left out.
    """
    for work in works:
        with _kept(Place(work)) as place:
            cells = [(cell.name, partial(_broken, place, cell)) for cell in _CELLS[work]]
            if work is not DEPLOY:
                cells.append(("log, disk full", partial(_full_disk, place)))
            for victim in VICTIMS[work] if kills else ():
                name = f"{victim.name} killed, {kills} times"
                cells.append((name, partial(killed, place, victim, kills, name)))
            for name, measured in cells:
                # The next one finds another machine where one went wrong.
                tried = partial(begun, place, measured)
                if only in name and not matrix.measure(work.name, name, tried):
                    place.leave()


_WORKS = {"level": LEVEL, "deploy": DEPLOY, "walk": WALK}


def run(console: Console) -> list[Measurement]:
    """The whole matrix, for all benchmarks."""
    matrix = Matrix(console)
    try:
        measure(matrix, [*_WORKS.values()], KILLS)
    finally:
        matrix.print()
    return matrix.measurements()


def main(arguments: list[str]) -> int:
    """The command; its exit code: 1 if a cell is not as it must be."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks faults", description=__doc__)
    parser.add_argument("jobs", nargs="*", metavar="JOB", help=f"{', '.join(_WORKS)}; default all")
    parser.add_argument(
        "--kills", type=int, default=KILLS, metavar="N", help=f"of each program; default {KILLS}"
    )
    parser.add_argument("--only", default="", metavar="TEXT", help="cells with this in their name")
    parser.add_argument("--seed", type=int, default=0, help="of the instants; default 0")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows as they come")
    options = parser.parse_args(arguments)
    if unknown := set(options.jobs) - set(_WORKS):
        parser.error(f"there is no job '{min(unknown)}'; there are: {', '.join(_WORKS)}")
    if not 0 <= options.kills <= 1000:
        parser.error(f"--kills {options.kills} is outside 0..1000")
    random.seed(options.seed)
    console = Console()
    matrix = Matrix(console, options.json)
    works = [_WORKS[name] for name in options.jobs or _WORKS]
    try:
        measure(matrix, works, options.kills, options.only)
    except KeyboardInterrupt:
        console.print("interrupted; measured until then:")
        matrix.print()
        return 130
    matrix.print()
    missed = [
        f"{row.machine}: {row.cell} ({row.verdict})" for row in matrix.rows if not row.passed
    ]
    if missed:
        console.print(f"missed: {'; '.join(missed)}", markup=False, highlight=False)
    return 1 if missed else 0
