"""The emulated machine in a program of its own, and what it leaves behind."""

import json
import os
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.machining_centre.machine import MACHINING_CENTRE
from parapod.diagrams.terrain_simulator.machine import TERRAIN_BENCH
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.sims.output.logs.part_messages import PartMessage
from parapod.sims.real_machine.age_limit import LOOKED
from parapod.systems.hardware.clock import CLOCK, EmulatedClock
from parapod.systems.hardware.emulation.harness import SharedHarness
from parapod.systems.hardware.position_memory import PositionMemory

# SIGINT is ignored by children of shells without job control, hence the default handler.
PARAPOD = (
    sys.executable,
    "-c",
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
    "from parapod.sims.cli.main import main; sys.exit(main())",
)


# Drives a machine with constant commands until it is killed, with the default timeouts.
DRIVING = """
import json, sys, time
from pathlib import Path
from parapod.diagrams.devices import make_parts
from parapod.diagrams.machine import find_machine
from parapod.sims.lab.discovery import find_entry
from parapod.systems.core.scenario_file import load_scenario

machine, commands = find_machine(sys.argv[1]), json.loads(sys.argv[2])
default = find_entry(machine.experiment).default_scenario
scenario = load_scenario(machine.scenario, default, *map(Path, sys.argv[3:]))
parts = make_parts(scenario.hardware.drivers, machine.inputs, machine.measured, 0.01)
with parts.active():
    print("driving", flush=True)
    while True:
        for part, threads in parts.threads.items():
            for thread in threads:
                names = thread.device.commands
                values = {name: commands[f"{part}.{name}"] for name in names}
                thread.post(values, time.monotonic())
        time.sleep(0.01)
"""


def load():
    """Programs that want to compute, for each core of this computer."""
    return os.getloadavg()[0] / len(os.sched_getaffinity(0))


def is_throttled():
    """Tell whether a quota, as some containers have one, has held this program back."""
    groups = Path("/proc/self/cgroup")
    for line in groups.read_text().splitlines() if groups.exists() else ():
        _, controllers, path = line.split(":", 2)
        if controllers and "cpu" not in controllers.split(","):
            continue
        told = Path("/sys/fs/cgroup", "cpu" if controllers else "", path[1:], "cpu.stat")
        with suppress(OSError):
            counts = dict(each.split() for each in told.read_text().splitlines())
            if int(counts.get("nr_throttled", 0)):
                return True
    return False


def skip_if_busy(said):
    """Skips a test on a computer that is busy, with the last line of what was said."""
    last = said.splitlines()[-1] if said else "nothing was said"
    if load() > 1.0:
        pytest.skip(f"{last}, at a load of {load():.1f} a core")
    if is_throttled():
        pytest.skip(f"{last}, and a quota holds programs back")


def _in_time(value, limit, what):
    """Fails where a limit is broken; on a computer that is busy, skips with what it managed."""
    print(f"{what}: {value:.3g}, of {limit:g}")
    if value >= limit:
        skip_if_busy(f"{what}: {value:.3g}, not {limit:g}")
        pytest.fail(f"{what}: {value:.3g}, not {limit:g}")


def _stamped(path, *names):
    stream_reader = pytest.importorskip("mcap.stream_reader")
    exceptions = pytest.importorskip("mcap.exceptions")
    channels, kinds, stamps, messages = {}, {}, [], {}
    with open(path, "rb") as stream:
        try:
            for record in stream_reader.StreamReader(stream).records:
                kind = type(record).__name__
                if kind == "Schema":
                    kinds[record.id] = record.name
                elif kind == "Channel" and "signals" in record.metadata:
                    part = PartMessage.from_metadata(
                        record.topic, kinds[record.schema_id], record.metadata
                    )
                    channels[record.id] = part
                elif kind == "Message" and record.channel_id in channels:
                    messages.setdefault(record.channel_id, []).append(record.data)
                    if record.channel_id == min(channels):
                        stamps.append(1e-9 * record.log_time)
        except (exceptions.EndOfFile, struct.error):
            pass  # in the middle of a record
    values = {}
    for channel, data in messages.items():
        values |= channels[channel].decoded(data)[1]
    count = min(map(len, values.values()))
    return (np.array(stamps[:count]), *(values[name][:count] for name in names))


# A short and quick walk.
CENTRE_JOB = (
    *("holes.count=0", "walk.advance_mm=20", "walk.steps=1", "walk.lift_mm=8"),
    *("motion.swing_mm_s=100", "motion.acceleration_mm_s2=1500", "control.settling=0.06"),
)


# A slow walk whose ground rises and falls, so that the belt runs and the sliders move.
BENCH_WALK = (
    *(
        "machine.configuration=treadmill",
        "control.period=0.01",
        "gait.speed_m_s=0.4",
        "gait.strides=1",
    ),
    *("gait.strides=1", "gait.run_up=0", "terrain=!Heave {amplitude_mm: 10}"),
    "hardware.drivers=[!Epos2Sliders {}, !Epos2HipSlide {}, !Epos2Belt {}, !NiDaqForceCells {}, "
    "!NotFittedPart {part: leg}]",
)


class Emulator:
    """`parapod emulate` in a process group and a folder of its own.

    Attributes:
        machine: that is emulated.
        options: of every emulator of it.
        experiment: that is emulated, by default the machine's.
        remembered: the signal that a file remembers from one program to the next, and the file.
        disturbable: parts whose devices are made to misbehave.
        drivers: parts that have devices; None: those of the machine's default scenario.
    """

    drivers = None

    @property
    def experiment(self):
        return self.machine.experiment

    def __init__(self, scenario=""):
        # A socket's path is short, which pytest's folders are not.
        self.directory = Path(tempfile.mkdtemp(prefix="pp", dir="/tmp"))
        self.log = self.directory / "emulator.mcap"
        self.environment = os.environ | {"PARAPOD_EMULATOR": str(self.directory / "e")}
        self.scenario = []
        if scenario:
            self.scenario = [str(self.directory / "machine.yaml")]
            Path(*self.scenario).write_text(scenario)
        options = [f"--scenario={path}" for path in self.scenario]
        command = (*PARAPOD, "emulate", self.experiment, "--log", self.log)
        self.process = subprocess.Popen(
            (*command, *self.options, *options),
            env=self.environment,
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            bufsize=1,
            start_new_session=True,
        )
        self.said = []
        threading.Thread(target=self._listen, daemon=True).start()
        if not self.until(lambda: any(line.startswith("ready") for line in self.said), 60.0):
            self.end()
            pytest.fail(f"the emulator does not begin: {self.said}")
        specs = (*self.machine.inputs, *self.machine.outputs)
        sizes = {spec.name: spec.size for spec in specs}
        parts = self.drivers or {d.part for d in self.machine.scenario().hardware.drivers}
        parts = sorted(parts)
        self.wires = SharedHarness(self.directory / "e" / "wires", sizes, parts)
        clock = self.directory / "e" / CLOCK
        self.clock = EmulatedClock(clock) if clock.exists() else None

    def now(self):
        """The time of the emulated devices [s]."""
        return time.monotonic() if self.clock is None else self.clock.now()

    def until_time(self, at, over=None):
        """Waits until it is so late for the emulated devices, or until something is over."""
        assert self.until(lambda: self.now() >= at or (over and over.is_set()), 120.0)

    def calendar_time(self):
        """The time that logs of the emulated devices have [s]."""
        return time.time() if self.clock is None else self.clock.calendar + self.clock.now()

    @staticmethod
    def first(stamps, holds, after):
        """How long after an instant something began to hold for good [s]."""
        later = stamps > after
        assert holds[later].any()
        last_not = np.flatnonzero(later & ~holds)
        index = last_not[-1] + 1 if last_not.size else np.flatnonzero(later)[0]
        assert index < len(stamps)
        return stamps[index] - after

    @staticmethod
    def until(condition, timeout):
        """Waits for something to become so; says whether it did."""
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                return False
            time.sleep(1e-3)
        return True

    def _listen(self):
        for line in self.process.stderr:
            self.said.append(line.strip())

    def misbehave(self, part, kind):
        """Returns when the devices do it."""
        line = f"{part} {kind}"
        count = len(self.said)
        self.process.stdin.write(f"{line}\n")
        is_done = self.until(lambda: any(s.endswith(line) for s in self.said[count:]), 5.0)
        assert is_done, line

    def program(self, *command, **options):
        """Begins a program that finds this machine; options of `Popen`."""
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        command = [*map(str, command)]
        return subprocess.Popen(command, env=self.environment, text=True, **(pipes | options))

    def parapod(self, *arguments, **options):
        """Begins `parapod` with these arguments."""
        return self.program(*PARAPOD, *arguments, **options)

    @staticmethod
    def companion(program, module):
        """Number of the process of its own in which a program runs a module."""
        children = Path(f"/proc/{program.pid}/task/{program.pid}/children")
        for pid in children.read_text().split():
            if module in Path(f"/proc/{pid}/cmdline").read_text().split("\0"):
                return int(pid)
        raise LookupError(f"no process for {module}")

    def run_well(self, *arguments):
        """What `parapod` says in a run that holds its bounds, on any computer."""
        _, said = (program := self.parapod(*arguments)).communicate(timeout=600)
        assert program.returncode == 0, "\n".join((said, *self.said))
        return said

    def driving(self, commands):
        """A program that has driven the machine for a while, with commands by port."""
        idle = {spec.name: [spec.idle] * spec.size for spec in self.machine.inputs}
        given = (self.machine.name, json.dumps(idle | commands), *self.scenario)
        end = time.monotonic() + 60.0
        while True:  # on a busy computer devices may answer too late
            program = self.program(sys.executable, "-c", DRIVING, *given)
            if program.stdout.readline() == "driving\n":
                time.sleep(0.6)
                return program
            _, said = program.communicate()
            assert time.monotonic() < end, said
            self.measure_legs()

    @contextmanager
    def disturbed(self, kind, *parts, after=1.0):
        """Makes devices misbehave once a job has driven them for a while.

        Yields the instants: when they begin to, and when the machine is neutral since.
        """
        instants, over = [], threading.Event()

        def disturb():
            if self.until(lambda: self.has_power or over.is_set(), 30.0):
                self.until_time(self.now() + LOOKED + after, over)
                instants.append(self.now())
                for part in parts:
                    self.misbehave(part, kind)
                if self.until(lambda: self.is_neutral or over.is_set(), 30.0) and self.is_neutral:
                    instants.append(self.now())

        thread = threading.Thread(target=disturb)
        thread.start()
        try:
            yield instants
        finally:
            over.set()
            thread.join()

    @contextmanager
    def here(self, monkeypatch):
        """Lets a controller in this process find the machine: neutral, well and referenced."""
        monkeypatch.setenv("PARAPOD_EMULATOR", self.environment["PARAPOD_EMULATOR"])
        assert self.until(lambda: self.is_neutral, 2.0)
        yield self
        if self.process.poll() is None:
            for part in self.disturbable:
                self.misbehave(part, "well")
        self.measure_legs()

    def logged(self, *names):
        """Wall clock [s] and, for each port, its values, of the log that is being written."""
        time.sleep(0.5)
        return _stamped(self.log, *names)

    @property
    def memory(self):
        """Of where the legs stood when a program ended."""
        signal, file = self.remembered
        size = len(self.wires.get(f"legs.{signal}"))
        return PositionMemory(self.directory / "e" / file, size, signal)

    def measure_legs(self):
        """What an operator does after a run that did not end in peace."""
        self.memory.save(self.wires.get(f"legs.{self.remembered[0]}"))

    def end(self):
        if self.process.poll() is None:
            self.process.terminate()
        try:
            self.process.wait(10.0)
        except subprocess.TimeoutExpired:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
        self.process.stdin.close()
        shutil.rmtree(self.directory, ignore_errors=True)


class EmulatedPlatform(Emulator):
    """The levelling platform."""

    machine, options = PLATFORM, ("--backend=kinematic",)
    remembered = "extension", "extensions.json"
    disturbable = ("imu", "legs", "wheels")

    @property
    def has_power(self):
        return self.wires.get("legs.stop")[0] < 0.5

    @contextmanager
    def looked_at(self):
        """Collects what is on the wires meanwhile."""
        seen, stopping = {"power": False, "voltage": 0.0, "wheels": False}, threading.Event()

        def look():
            while not stopping.wait(1e-3):
                seen["power"] |= self.has_power
                seen["voltage"] = max(seen["voltage"], *map(abs, self.wires.get("legs.voltage")))
                seen["wheels"] |= self.wires.get("wheels.brake")[0] < 0.5

        thread = threading.Thread(target=look)
        thread.start()
        try:
            yield seen
        finally:
            stopping.set()
            thread.join()

    @property
    def is_neutral(self):
        legs = not self.has_power and self.wires.get("legs.voltage") == (0.0,) * 4
        speeds = self.wires.get("wheels.velocity_command")
        return legs and self.wires.get("wheels.brake")[0] > 0.5 and speeds == (0.0,) * 4


class EmulatedPlatformByTheClock(EmulatedPlatform):
    """The platform in the computer's own time, as beside real devices."""

    options = (*EmulatedPlatform.options, "--rate=1")


class EmulatedPlatformOnLcm(EmulatedPlatformByTheClock):
    """The platform with all its parts on LCM."""

    options = (*EmulatedPlatformByTheClock.options, "--lcm")


class EmulatedPlatformOnRos2(EmulatedPlatformByTheClock):
    """The platform with all its parts on ROS 2."""

    options = (*EmulatedPlatformByTheClock.options, "--ros2")


class EmulatedDeploymentByTheClock(EmulatedPlatformByTheClock):
    """The platform where its operation begins."""

    experiment = "deploy"


class EmulatedInspection(EmulatedPlatform):
    """The platform with its arm on drives."""

    experiment = "inspect"


class EmulatedPlatformOnWheels(EmulatedPlatform):
    """The platform before it has been anywhere, on level ground."""

    options = (*EmulatedPlatform.options, "--set", "job.start=wheels", "ground={roll_deg: 0}")


class EmulatedPlatformOnLevelGround(EmulatedPlatform):
    """The platform on its feet, on level ground."""

    options = (*EmulatedPlatform.options, "--set", "ground={roll_deg: 0, pitch_deg: 0}")


class EmulatedPlatformWithGains(EmulatedPlatform):
    """The platform on its wheels on level ground, its gains off by up to a tenth."""

    options = (
        *EmulatedPlatformOnLevelGround.options,
        *("job.start=wheels", "machine.actuators.gain_error=0.1"),
    )


class EmulatedChair(Emulator):
    """The walking chair."""

    machine = CHAIR
    options = ("--backend=multibody", "--set", "plant.time_step=0.002")
    remembered = "position", "positions.json"
    disturbable = ("legs",)

    @property
    def has_power(self):
        return self.wires.get("legs.brake")[0] < 0.5

    @property
    def is_neutral(self):
        return not self.has_power and not any(self.wires.get("legs.velocity_command"))


class EmulatedChairByTheClock(EmulatedChair):
    """The chair in the computer's own time."""

    options = ("--rate=1", *EmulatedChair.options)


class EmulatedCentre(Emulator):
    """A tripod that walks a little."""

    machine = MACHINING_CENTRE
    options = ("--backend=kinematic", "--set", *CENTRE_JOB)
    remembered = "position", "positions.json"
    disturbable = ("legs", "switches")

    @property
    def has_power(self):
        return self.wires.get("legs.brake")[0] < 0.5

    @property
    def is_neutral(self):
        closed = self.wires.get("locks.command") + self.wires.get("clamps.command")
        return not self.has_power and all(value > 0.5 for value in closed)


class EmulatedBench(Emulator):
    """A terrain simulator with a treadmill, on which no leg stands."""

    machine = TERRAIN_BENCH
    options = ("--backend=kinematic", "--set", *BENCH_WALK)
    disturbable = ("sliders", "hip", "cells", "belt")

    def measure_legs(self):
        for part in ("sliders", "hip"):
            now = self.wires.get(f"{part}.position")
            file = self.directory / "e" / f"{part}.json"
            PositionMemory(file, len(now), "position").save(now)

    @property
    def has_power(self):
        return self.wires.get("sliders.brake")[0] < 0.5

    @property
    def is_neutral(self):
        braked = all(
            self.wires.get(f"{part}.brake")[0] > 0.5 for part in ("sliders", "hip", "belt")
        )
        idle = not any(
            self.wires.get("hip.force_command") + self.wires.get("belt.velocity_command")
        )
        return braked and idle


@pytest.fixture(scope="module")
def emulators():
    """emulators(kind, scenario="") begins an `Emulator`, which ends after the module's tests."""
    with ExitStack() as stack:

        def begin(kind, scenario=""):
            emulator = kind(scenario)
            stack.callback(emulator.end)
            return emulator

        yield begin


@pytest.fixture(scope="module")
def emulate(emulators):
    """emulate(scenario="") begins an `EmulatedPlatform`."""
    return partial(emulators, EmulatedPlatform)


@pytest.fixture(scope="module")
def emulate_by_the_clock(emulators):
    """emulate_by_the_clock(scenario="") begins an `EmulatedPlatformByTheClock`."""
    return partial(emulators, EmulatedPlatformByTheClock)


@pytest.fixture(scope="module")
def emulate_for(emulators):
    """emulate_for(job) begins the `Emulator` of a job, in the computer's own time."""
    kinds = {
        "level": EmulatedPlatformByTheClock,
        "lcm": EmulatedPlatformOnLcm,
        "ros2": EmulatedPlatformOnRos2,
        "deploy": EmulatedDeploymentByTheClock,
        "walk": EmulatedChairByTheClock,
    }
    return lambda job: emulators(kinds[job])


@pytest.fixture(scope="module")
def emulate_inspection(emulators):
    """emulate_inspection() begins an `EmulatedInspection`."""
    return partial(emulators, EmulatedInspection)


@pytest.fixture(scope="module")
def emulate_on_wheels(emulators):
    """emulate_on_wheels() begins an `EmulatedPlatformOnWheels`."""
    return partial(emulators, EmulatedPlatformOnWheels)


@pytest.fixture(scope="module")
def emulate_on_level_ground(emulators):
    """emulate_on_level_ground() begins an `EmulatedPlatformOnLevelGround`."""
    return partial(emulators, EmulatedPlatformOnLevelGround)


@pytest.fixture(scope="module")
def emulate_gains(emulators):
    """emulate_gains() begins an `EmulatedPlatformWithGains`."""
    return partial(emulators, EmulatedPlatformWithGains)


@pytest.fixture(scope="session", name="skip_if_busy")
def _skip_if_busy():
    """skip_if_busy(said) skips a test on a busy computer, with what a program said last."""
    return skip_if_busy


@pytest.fixture(scope="module")
def emulate_chair(emulators):
    """emulate_chair(scenario="") begins an `EmulatedChair`."""
    return partial(emulators, EmulatedChair)


@pytest.fixture(scope="module")
def emulate_centre(emulators):
    """emulate_centre(scenario="") begins an `EmulatedCentre`."""
    return partial(emulators, EmulatedCentre)


@pytest.fixture(scope="session")
def stamped():
    """stamped(path, *names): wall clock [s] and each port's values, also of an unfinished log."""
    return _stamped


@pytest.fixture(scope="session")
def in_time():
    """in_time(value, limit, what) fails if a limit is broken, but skips on a busy computer."""
    return _in_time


@pytest.fixture(scope="module")
def emulate_bench(emulators):
    """emulate_bench(scenario="") begins an `EmulatedBench`."""
    return partial(emulators, EmulatedBench)
