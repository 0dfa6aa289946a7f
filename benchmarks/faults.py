"""Faults of emulated devices and killed programs: what is found, how soon, and what is live then.

Each cell is a job of a real machine, driven through emulated devices one of which begins to
misbehave while the legs move. Its answer is the time until the legs have no power.
"""

import math
import os
import random
import signal
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from benchmarks.emulated import Emulated, emulated, until
from benchmarks.report import Measurement
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.sims.lab.mcap import read_mcap
from parapod.systems.hardware.emulation.harness import KINDS

# Longest time until the legs have no power: a sensor that is stuck is found when the platform
# moves on, a device that comes and goes when it has been away for long enough; others, and a
# killed program [s].
_ANSWERED = {"stuck": 3.0, "intermittent": 2.5}
_USUAL, _KILLED = 1.0, 0.25
# Jobs in which legs move all the time, and how long one takes at most [s].
_LEVEL = ("run", "level", "--backend", "hardware", "--set", "job.estimate_at=1.5")
_WALK = ("run", "chair-walk", "--backend", "hardware", "--set", "begin=0.5")
_LONGEST = 60.0
_KILLS = 20


class Cell(NamedTuple):
    """Outcome of a job.

    Attributes:
        name: part and kind.
        answer: time until the legs had no power [s]; infinite where nothing was found.
        code: exit code.
        is_live: whether outputs were live in the end.
        words: last line that it said.
    """

    name: str
    answer: float
    code: int
    is_live: bool
    words: str


class _Bench:
    """A machine with its job."""

    def __init__(self, machine: Emulated, is_chair: bool, console: Console):
        self.machine, self.is_chair, self._console = machine, is_chair, console
        self._turns = 0

    @property
    def has_power(self) -> bool:
        name = "legs.brake" if self.is_chair else "legs.stop"
        return self.machine.wires.get(name)[0] < 0.5

    @property
    def is_moving(self) -> bool:
        name, least = ("velocity_command", 2e-3) if self.is_chair else ("voltage", 0.3)
        return max(map(abs, self.machine.wires.get(f"legs.{name}"))) > least

    @property
    def job(self) -> tuple[str, ...]:
        """Arguments of the next job; the platform goes up and down in turns."""
        if self.is_chair:
            return _WALK
        self._turns += 1
        heights = (465.0, 490.0) if self._turns % 2 else (490.0, 465.0)
        waypoints = [
            f"{{time: {2.0 + 2.5 * k}, height_mm: {h - 477.0}}}" for k, h in enumerate(heights)
        ]
        return (
            *_LEVEL,
            f"job.waypoints=[{', '.join(waypoints)}]",
            "job.arm={start: 0.5, duration: 0.5}",
            "job.settled_after=1.5",
            "job.end=8",
        )

    def cell(self, part: str, kind: str, *options: str) -> Cell:
        """One job with one fault."""
        program = self.machine.parapod(*self.job, *options)
        self._wait_for_motion(program)
        self.machine.misbehave(part, kind)
        answer = until(lambda: not self.has_power or program.poll() is not None, _LONGEST)
        _, said = program.communicate(timeout=_LONGEST)
        is_live = not math.isfinite(until(lambda: not self.has_power, 1.0))
        self.machine.misbehave(part, "released" if part == "emergency_stop" else "well")
        self.machine.remember("position" if self.is_chair else "extension")
        lines = said.strip().splitlines() or [""]
        code = program.returncode
        words = " ".join((part, kind, *options[1:]))
        found = Cell(words, answer if code else math.inf, code, is_live, lines[-1])
        shown = f"{found.answer:.2f} s" if code else "not found"
        self._console.print(f"  {words}: {shown}; {found.words[:120]}", highlight=False)
        return found

    def _wait_for_motion(self, program: "subprocess.Popen[str]") -> None:
        if not math.isfinite(until(lambda: self.has_power and self.is_moving, 20.0)):
            program.kill()
            raise RuntimeError(f"the job does not begin: {program.communicate()[1]}")

    def killed(self, log: Path) -> float:
        """Time from SIGKILL of a job at a random instant until the legs have no power [s]."""
        program = self.machine.parapod(*self.job, "--log", str(log))
        self._wait_for_motion(program)
        until(lambda: False, random.uniform(0.0, 4.0))
        os.kill(program.pid, signal.SIGKILL)
        answer = until(lambda: not self.has_power, 5.0)
        program.wait()
        self.machine.remember("position" if self.is_chair else "extension")
        return answer


def run(console: Console) -> list[Measurement]:
    with _platform(console) as bench:
        cells = [bench.cell(part, kind) for part in ("legs", "imu", "wheels") for kind in KINDS]
        cells.append(bench.cell("emergency_stop", "pressed"))
        # A button that only cuts the supply, and tells nobody.
        unseen = 'hardware.drivers.0.stop_input=""'
        cells.append(bench.cell("emergency_stop", "pressed", "--set", unseen))
        results = _rows("platform", cells) + _kills("platform", lambda: nullcontext(bench))
    cells = []
    for part, kind in (*(("legs", kind) for kind in KINDS), ("emergency_stop", "pressed")):
        with _chair(console) as bench:
            cells.append(bench.cell(part, kind))
    return results + _rows("chair", cells) + _kills("chair", partial(_chair, console))


@contextmanager
def _platform(console: Console) -> Iterator[_Bench]:
    with emulated(PLATFORM, "--backend", "kinematic") as machine:
        yield _Bench(machine, False, console)


@contextmanager
def _chair(console: Console) -> Iterator[_Bench]:
    """A chair that stands where its walk begins."""
    with emulated(CHAIR, "--backend", "multibody", "--set", "plant.time_step=0.002") as machine:
        yield _Bench(machine, True, console)


def _rows(machine: str, cells: Sequence[Cell]) -> list[Measurement]:
    found = [cell for cell in cells if cell.code == 2]
    unnoticed = [cell.name for cell in cells if cell.code != 2]
    words = f" ({', '.join(unnoticed)})" if unnoticed else ""
    live = sum(cell.is_live for cell in cells)
    rows = [
        Measurement(f"{machine}: faults that end the job, of {len(cells)}", len(found), ""),
        Measurement(f"{machine}: jobs that end well all the same{words}", len(unnoticed), ""),
        Measurement(f"{machine}: jobs that leave outputs live", live, "", 0, 0, True),
    ]
    for cell in found:
        bound = _ANSWERED.get(cell.name.split()[1], _USUAL)
        rows.append(Measurement(f"{machine}: {cell.name}", cell.answer, "s", bound, None, True))
    return rows


def _kills(machine: str, place: Callable[[], AbstractContextManager[_Bench]]) -> list[Measurement]:
    """Programs that are killed at random instants, and their logs."""
    answers, readable = [], 0
    for k in range(_KILLS):
        with place() as bench:
            log = bench.machine.folder / f"killed{k}.mcap"
            answers.append(bench.killed(log))
            until(lambda: False, 0.5)  # in which the log's process finishes it
            readable += len(read_mcap(log).time) > 0
            log.unlink()
    slowest = f"{machine}: killed {_KILLS} times: no power within"
    return [
        Measurement(slowest, max(answers), "s", _KILLED, None, True),
        Measurement(f"{machine}: readable logs of {_KILLS}", readable, "", _KILLS, None),
    ]
