"""Everything that can break, one thing at a time, while a machine works on emulated devices.

A job must find it in time, name it, end with another exit code than 0 and leave no outputs live.
`make slow ARGS=tests/sims/real_machine/test_fault_matrix.py` tries all cells, in half an hour.
"""

import itertools
import os
import re
import resource
import signal
import subprocess
import threading
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from parapod.sims.output.logs.files import read_log
from parapod.systems.core.errors import OutputError
from parapod.systems.hardware.emulation.harness import KINDS

for library in ("nidaqmx", "grpc", "canopen", "can", "mcap", "rclpy"):
    pytest.importorskip(library)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc"),
]

# How long a job may take to move, and to end; commands that rest for so long have stopped [s].
BEGINNING, LONGEST, STILL = 60.0, 90.0, 0.3
# Instants of a job at which each program is killed, evenly over so much of it [s].
KILLS, DURATION = 5, 4.0
HEIGHTS = itertools.cycle(((490.0, 465.0), (465.0, 490.0)))


class Job(NamedTuple):
    """A job during which something breaks.

    Attributes:
        arguments: makes those of `parapod`.
        moving: commands, and from which value on they move something.
        ends: whether it answers a fault by taking the legs' power; else it holds them first.
        is_fresh: whether it needs a machine at the beginning of its scenario.
    """

    arguments: object
    moving: dict
    ends: bool = True
    is_fresh: bool = True


def level(part=""):
    """Up and down, or down and up, so that legs move in each job."""
    waypoints = [
        f"{{time: {2.0 + 2.5 * k}, height_mm: {height - 477.0}}}"
        for k, height in enumerate(next(HEIGHTS))
    ]
    return (
        *("run", "level", "--backend", "hardware", "--set", "job.estimate_at=1.5"),
        f"job.waypoints=[{', '.join(waypoints)}]",
        *("job.arm={start: 0.5, duration: 0.5}", "job.settled_after=1.5", "job.end=8"),
        *(
            (
                f"hardware.drivers=[{part.format('legs')}, {part.format('wheels')}, "
                f"{part.format('imu')}, {part.format('arm')}]",
            )
            if part
            else ()
        ),
    )


JOBS = {
    "level": Job(level, {"legs.voltage": 0.3}, is_fresh=False),
    "lcm": Job(partial(level, "!LcmPart {{part: {}}}"), {"legs.voltage": 0.3}, is_fresh=False),
    "ros2": Job(partial(level, "!Ros2Part {{part: {}}}"), {"legs.voltage": 0.3}, is_fresh=False),
    "deploy": Job(
        lambda: ("run", "deploy", "--backend", "hardware"),
        {"legs.voltage": 0.3, "wheels.velocity_command": 0.1},
        ends=False,
    ),
    "walk": Job(
        lambda: ("run", "chair-walk", "--backend", "hardware", "--set", "begin=0.5"),
        {"legs.velocity_command": 2e-3},
    ),
}


class Cell(NamedTuple):
    """One thing that is broken in a job.

    Attributes:
        job: name of the job.
        part: part that is told to misbehave.
        kind: how.
        on: command that must move before; "": the first of the job's.
        bound: longest time for the answer [s]; None: as the kind has it.
        harmless: why it may stay unfound; "": it must be found.
        options: further arguments of the job.
    """

    job: str
    part: str
    kind: str
    on: str = ""
    bound: float | None = None
    harmless: str = ""
    options: tuple[str, ...] = ()


# A sensor that is stuck is found when the platform moves on, a device that comes and goes when it
# has been away for long enough [s].
USUAL, LATER = 1.0, {"stuck": 3.0, "intermittent": 2.5, "delayed": 1.5}
# Without its contact the emergency stop cuts the supply, and no signal shows it.
UNSEEN = ("--set", 'hardware.drivers.0.stop_input=""')
IDLE = "nothing drives the wheels in this job: see deploy"
STANDS = "the sensor is looked at while the platform stands or turns slowly: see deploy"
SLOW = "the platform turns so slowly that samples of 0.1 or 0.2 s ago are as good"
BRAKED = "no controller looks at wheel angles: the operator sees where the machine drives"
OLD, LYING = ("slow", "delayed"), ("stuck", "wrong", "slow", "delayed")
CELLS = (
    *(Cell("level", "legs", kind) for kind in KINDS),
    *(Cell("level", "imu", kind, harmless=STANDS if kind in OLD else "") for kind in KINDS),
    *(Cell("level", "wheels", kind, harmless=IDLE if kind in LYING else "") for kind in KINDS),
    *(
        Cell(bus, part, kind, harmless=STANDS if part == "imu" and kind in OLD else "")
        for bus in ("lcm", "ros2")
        for part in ("legs", "imu")
        for kind in KINDS
    ),
    *(Cell("level", "drives", kind, bound=2.5) for kind in KINDS if kind != "unplugged"),
    Cell("level", "supply", "lost"),
    Cell("level", "emergency_stop", "pressed"),
    Cell("level", "emergency_stop", "pressed", bound=2.5, options=UNSEEN),
    *(Cell("deploy", "imu", kind, "legs.voltage", harmless=SLOW) for kind in OLD),
    Cell("deploy", "imu", "wrong", "legs.voltage"),
    *(
        Cell("deploy", "wheels", kind, "wheels.velocity_command", harmless=BRAKED)
        for kind in LYING
    ),
    Cell("deploy", "switches", "closed", "wheels.velocity_command"),
    Cell("deploy", "switches", "open", "legs.voltage", bound=60.0),
    *(Cell("walk", "legs", kind) for kind in KINDS),
    Cell("walk", "supply", "lost"),
    Cell("walk", "emergency_stop", "pressed"),
)
# What may be found of a broken part.
LEGS = "PXIe|EPOS2|leg|encoder|feet|supply|emergency_stop|following|current|no_support|posture"
NAMED = {
    **dict.fromkeys(("legs", "drives", "supply", "emergency_stop"), LEGS),
    "imu": "ADIS|imu|gyro|accel|posture_mismatch|pushed_up",
    "wheels": "EPOS2",
    "switches": "switch|ground within its stroke",
}
WELL = {"emergency_stop": "released", "supply": "back"}


class Work:
    """A job that works.

    Attributes:
        machine: the emulated machine.
        process: the program.
        said: lines on its standard error.
    """

    def __init__(self, machine, job, *options):
        self.machine, self.job, self.said = machine, job, []
        self.process = machine.parapod(*job.arguments(), *options, stdout=subprocess.DEVNULL)
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self):
        self.said += (line.strip() for line in self.process.stderr if line.strip())

    @property
    def has_ended(self):
        return self.process.poll() is not None

    def moves(self, command):
        return max(map(abs, self.machine.wires.get(command))) > self.job.moving[command]

    def begins(self, command):
        """Waits until a command moves something; says whether it does."""
        self.until(
            lambda: self.has_ended or (self.machine.has_power and self.moves(command)), BEGINNING
        )
        return not self.has_ended and self.moves(command)

    @property
    def is_moving(self):
        return any(map(self.moves, self.job.moving))

    def until(self, condition, longest, lasting=0.0):
        """Time until something holds for a while [s]; infinite if it does not in time."""
        begun, since = time.monotonic(), None
        while (now := time.monotonic()) < begun + longest:
            since = (since or now) if condition() else None
            if since is not None and now >= since + lasting:
                return since - begun
            time.sleep(1e-3)
        return np.inf

    def answer(self):
        """Time until the machine has answered what has been broken [s]."""
        if self.job.ends:
            return self.until(lambda: self.has_ended or not self.machine.has_power, LONGEST)
        return self.until(lambda: self.has_ended or not self.is_moving, LONGEST, STILL)

    def end(self):
        """Exit code, and the last line; no outputs may be live a second later."""
        code = self.process.wait(LONGEST)
        self.until(lambda: not self.machine.has_power and not self.is_moving, 1.0)
        assert not self.machine.has_power
        assert not self.is_moving
        return code, self.said[-1].removeprefix("parapod: error: ") if self.said else ""

    @property
    def logger(self):
        """Number of the process that writes its log."""
        return self.machine.companion(self.process, "parapod.sims.lab.log_process")


@pytest.fixture(scope="module")
def machines(emulate_for):
    """machines(job): its machine, begun anew where that is needed; no other one runs beside it."""
    running = {}

    def get(name, afresh=False):
        for other in list(running):
            if other != name or afresh or JOBS[name].is_fresh:
                running.pop(other).end()
        if name not in running:
            running[name] = emulate_for(name)
        return running[name]

    return get


@pytest.fixture
def working(machines):
    """working(job, *options, on=""): the `Work`, whose legs move; it is well and known after."""

    @contextmanager
    def begin(name, *options, on=""):
        job, machine = JOBS[name], machines(name)
        on = on or next(iter(job.moving))
        for attempts_left in (2, 1, 0):  # a busy computer may be refused
            work = Work(machine, job, *options)
            if work.begins(on):
                break
            assert attempts_left, work.said
            machine = machines(name, afresh=True)
        try:
            yield work
        finally:
            work.process.kill()
            work.process.wait()
            if machine.process.poll() is None:
                machine.measure_legs()

    return begin


@pytest.mark.parametrize(
    "cell",
    CELLS,
    ids=lambda c: f"{c.job}-{c.part}-{c.kind}{'-no-contact' if c.options else ''}",
)
def test_whatever_breaks_is_found_in_time_and_named_and_leaves_nothing_live(
    working, in_time, skip_if_busy, record_property, cell
):
    with working(cell.job, *cell.options, on=cell.on) as work:
        work.machine.misbehave(cell.part, cell.kind)
        try:
            after = work.answer()
            code, said = work.end()
        finally:
            work.machine.misbehave(cell.part, WELL.get(cell.part, "well"))
    record_property("after_s", after)
    record_property("said", said)
    assert code in ((0, 2) if cell.harmless else (2,)), said
    if code != 0 and not re.search(NAMED[cell.part], said):
        skip_if_busy(said)
        pytest.fail(f"another thing was found: {said}")
    if not cell.harmless:
        bound = LATER.get(cell.kind, USUAL) if cell.bound is None else cell.bound
        in_time(after, bound, f"answer to {cell.part} {cell.kind} [s]")


@pytest.mark.parametrize("job", ["level", "walk"])
def test_a_log_whose_disk_becomes_full_ends_its_job(working, in_time, skip_if_busy, tmp_path, job):
    log = tmp_path / "full.mcap"
    with working(job, "--log", log) as work:
        writer, size = work.logger, log.stat().st_size + 4096
        try:
            resource.prlimit(writer, resource.RLIMIT_FSIZE, (size, size))
        except OSError as error:
            pytest.skip(f"no limit can be set: {error}")
        after = work.until(lambda: any("cannot write" in line for line in work.said), LONGEST)
        code, said = work.end()
    assert code == 2
    if "cannot write" not in said:
        skip_if_busy(said)
        pytest.fail(f"another thing was found: {said}")
    in_time(after, USUAL, "end after the disk became full [s]")


def is_readable(log):
    """Tell whether a log has samples."""
    try:
        return len(read_log(log).time) > 0
    except OutputError:
        return False


def is_killed(process):
    """Kill a process; tell whether there was one."""
    try:
        os.kill(process, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def check_next(machine):
    """Proves that the next program is refused, or leaves a machine that is neutral."""
    program = machine.parapod("check", "legs", "--of", machine.experiment, "--seconds", "0.1")
    said = program.communicate(timeout=LONGEST)
    assert program.returncode in (0, 1, 2), said
    assert machine.until(lambda: machine.is_neutral, 1.0)


@pytest.mark.parametrize("instant", np.linspace(0.0, DURATION, KILLS), ids="{:.0f}s".format)
@pytest.mark.parametrize("job", ["level", "walk"])
@pytest.mark.parametrize(
    ("victim", "bound"),
    [("controller", 0.25), ("logger", 1.0), ("emulator", 4.0)],  # asked for two seconds more
)
def test_whichever_program_is_killed_the_machine_stands_and_the_log_is_readable(
    working, machines, in_time, skip_if_busy, tmp_path, victim, bound, job, instant
):
    log = tmp_path / "killed.mcap"
    with working(job, "--log", log) as work:
        machine = work.machine
        processes = {"controller": work.process.pid, "logger": work.logger}
        processes["emulator"] = machine.process.pid
        work.until(lambda: work.has_ended, instant)
        if work.has_ended or not is_killed(processes[victim]):
            work.process.wait(LONGEST)
            skip_if_busy("\n".join(work.said))
            pytest.fail(f"ended before the kill: {work.said}")
        if victim == "controller":
            after = work.until(lambda: not machine.has_power, 5.0)
            time.sleep(1.0)  # in which the log's process ends the log
        elif victim == "logger":
            after = work.until(lambda: any("cannot write" in s for s in work.said), 5.0)
        else:
            after = work.until(lambda: work.has_ended, LONGEST)
            assert work.process.wait(LONGEST) == 2, work.said
            machine = machines(job, afresh=True)
        if victim != "emulator":
            assert work.end()[0] == (-signal.SIGKILL if victim == "controller" else 2)
        assert is_readable(log)
        check_next(machine)
    machine.measure_legs()
    in_time(after, bound, f"answer to a killed {victim} [s]")
