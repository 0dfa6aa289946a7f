"""The platform's controller in one program and the emulated platform in another."""

import gc
import io
import itertools
import json
import os
import re
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from rich.console import Console

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.devices import make_parts
from parapod.diagrams.drivers.driver import Driver
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.cli.main import main
from parapod.sims.output.logs.files import read_log
from parapod.sims.output.options import RunOptions
from parapod.sims.real_machine.age_limit import LOOKED
from parapod.sims.real_machine.job import run_on_hardware
from parapod.sims.real_machine.real_time import DeadlineError
from parapod.systems.core.physics import STANDARD_GRAVITY
from parapod.systems.hardware.device import Device
from parapod.systems.hardware.emulation.harness import KINDS

for library in ("nidaqmx", "grpc", "canopen", "can", "serial", "mcap"):
    pytest.importorskip(library)

# Where programs may not have a priority, others delay heartbeats by more than a wheel bears, and
# resets by more than the card does.
PATIENT = ("hardware.drivers.2.heartbeat_timeout_ms=500", "hardware.drivers.0.watchdog_ms=500")
PARTS = ("arm", "imu", "legs", "wheels")
HEIGHTS = itertools.cycle((485.0, 470.0))


@pytest.fixture(scope="module")
def machine(emulate):
    return emulate()


@pytest.fixture
def here(machine, monkeypatch):
    """The machine, for a controller in this process."""
    with machine.here(monkeypatch):
        yield machine


def job(estimate_at, settled_after, end, height=477.0):
    return (
        *("run", "level", "--backend", "hardware", "--set", "job.waypoints=[]"),
        f"job.estimate_at={estimate_at}",
        f"job.settled_after={settled_after}",
        f"job.end={end}",
        f"job.height_mm={height}",
        "job.arm={start: 0, duration: 0.1, angle_deg: 1}",
        *PATIENT,
    )


def brief(end=3.0):
    """A job whose legs move half a second after it has begun."""
    return job(0.5, 0.5, end, next(HEIGHTS))


# --- a run that goes well: the path that every change must leave open


class Levelled(NamedTuple):
    log: Path
    metrics: dict
    said: str
    left: tuple
    stood: tuple


def test_the_clock_knows_whether_all_devices_are_well(machine):
    """Answers of those that misbehave are not waited for as long."""
    assert machine.until(lambda: machine.clock.is_well, 60.0)
    machine.misbehave("imu", "off")
    assert machine.until(lambda: not machine.clock.is_well, 60.0)
    machine.misbehave("imu", "well")
    assert machine.until(lambda: machine.clock.is_well, 60.0)


@pytest.fixture(scope="module")
def levelled(machine):
    """A whole job, by a controller in another process."""
    log, metrics = machine.directory / "hil.mcap", machine.directory / "hil.json"
    machine.measure_legs()
    said = machine.run_well(*job(1.0, 3.5, 4.5), "--log", log, "--json", metrics)
    stood = machine.wires.get("legs.extension")
    return Levelled(log, json.loads(metrics.read_text()), said, machine.memory.recall(), stood)


def test_a_job_on_the_emulated_machine_holds_its_bounds_as_measured(levelled, machine):
    assert levelled.metrics["passed"] is True
    assert levelled.metrics["backend"] == "hardware"
    assert levelled.metrics["roll_error_deg"] < 0.2
    assert levelled.metrics["height_error_mm"] < 2.0
    assert machine.is_neutral


def test_a_job_on_the_emulated_machine_holds_its_bounds_in_truth(levelled, machine):
    log = read_log(levelled.log)
    settled = log.time >= 4.5
    begin = log.metadata["wall_time"] + log.time[settled][0]
    end = log.metadata["wall_time"] + log.time[-1]
    stamps, posture = machine.logged("truth.posture")
    true = posture[(stamps >= begin) & (stamps <= end)]
    assert len(true) > 50
    assert np.degrees(np.abs(true[:, :2])).max() < 0.2
    assert 1e3 * np.abs(true[:, 2] - 0.477).max() < 2.0
    # It was not level by itself.
    assert np.degrees(np.abs(posture[0, :2])).max() > 1.0
    assert set(log.metadata["units"]) == set(log.signals)


def test_the_age_of_measurements_is_said_after_a_run(levelled):
    for device in ("PXIe-6363", "EPOS2"):
        lines = levelled.said.splitlines()
        (line,) = [one for one in lines if one.startswith(device) and " ms old " in one]
        words = r"were [\d.]+, [\d.]+, [\d.]+ ms old .* written, \d+ of \d+ above one period"
        assert re.search(words, line)


def test_the_next_program_knows_the_extensions_with_which_the_one_before_ended(levelled):
    assert levelled.left == pytest.approx(levelled.stood, abs=2e-5)
    assert max(abs(x - 0.41) for x in levelled.left) > 1e-3  # not as the scenario has it


# --- how fresh measurements are


def ages_of(loop, duration):
    """Ages when commands had been written [s]: of the legs, of the wheels."""
    options = RunOptions(console=Console(file=io.StringIO()))
    run_on_hardware(loop, Simulator(loop), duration, options, "freshness")
    threads = loop.station.behind.handle.threads
    return [np.array(threads[part][0].write_ages) for part in ("legs", "wheels")]


def freshest(check, limit, in_time, what, attempts=4):
    """Judges the least disturbed of a few runs by the share that is late."""
    shares = []
    for _ in range(attempts):
        shares.append(1.0 - check())
        if shares[-1] < limit:
            return
    in_time(min(shares), limit, what)


@pytest.mark.slow
def test_measurements_are_mostly_younger_than_a_period_when_commands_are_written(
    levelled, here, in_time
):
    scenario = LevellingScenario(backend="hardware")
    scenario.hardware.drivers[2].heartbeat_timeout_ms = 500.0
    scenario.hardware.drivers[0].watchdog_ms = 500.0

    def check():
        legs, _ = ages_of(ClosedLoop(PLATFORM, scenario, log=()), 2.0)
        return np.mean(legs < scenario.control.period)

    freshest(check, 0.2, in_time, "share of late measurements")


class FastPart(Device):
    """Reads in 2 ms; stands still on level ground."""

    still: ClassVar = {"extension": 0.41, "accel": (0.0, 0.0, STANDARD_GRAVITY)}

    def __init__(self, part, ports):
        self.name, self.measures, self.commands = part, ports.measures, ports.commands

    def configure(self):
        pass

    def activate(self):
        self.collected_with_power = gc.isenabled()
        self.policy_of_loop = os.sched_getscheduler(0)

    def read(self):
        self.policy = os.sched_getscheduler(0)
        time.sleep(2e-3)
        return {
            name: np.broadcast_to(self.still.get(name, 0.0), size).tolist()
            for name, size in self.measures.items()
        }

    def close(self):
        pass


@dataclass
class FastDriver(Driver):
    def make(self, ports):
        return FastPart(self.part, ports)


def fast_loop():
    hardware = HardwareScenario([FastDriver(part) for part in PARTS])
    return ClosedLoop(PLATFORM, LevellingScenario(backend="hardware", hardware=hardware), log=())


@pytest.mark.slow
def test_measurements_of_fast_devices_are_hardly_older_than_a_reading(in_time):
    def check():
        # Readings end just before they are taken, and do not happen to.
        return min(np.mean(ages < 5e-3) for ages in ages_of(fast_loop(), 2.0))

    freshest(check, 0.5, in_time, "share of late measurements of fast devices")


def test_devices_with_power_wait_for_no_garbage_collector_and_threads_have_the_loops_priority(
    in_time,
):
    # Both would keep heartbeats from drives that wait for them.
    loop = fast_loop()
    options = RunOptions(console=Console(file=io.StringIO()))
    try:
        run_on_hardware(loop, Simulator(loop), 0.1, options, "undisturbed")
    except DeadlineError as error:
        in_time(np.inf, 1.0, f"share of missed deadlines: {error}")
    for thread in loop.station.behind.handle.all_threads:
        assert not thread.device.collected_with_power
        assert thread.device.policy == thread.device.policy_of_loop
    assert gc.isenabled()


# --- devices that misbehave


class Ended(NamedTuple):
    code: int
    error: str
    took: float
    neutral: float
    seen: dict


def put_back(machine, extension):
    """Drives the legs to where they have been, lest the next job's posture is out of reach."""
    drivers = LevellingScenario().hardware.drivers
    drivers[0].watchdog_ms = 500.0
    parts = make_parts(drivers, PLATFORM.inputs, PLATFORM.measured, 0.01)
    (legs,) = parts.threads["legs"]
    machine.measure_legs()

    def arrived():
        error = np.array(extension) - legs.sample.values["extension"]
        # So slowly that the legs come to rest also where a busy computer delays all of it.
        voltage = np.clip(1e3 * error, -8.0, 8.0)
        legs.post({"voltage": voltage, "stop": [0.0]}, time.monotonic())
        return np.abs(error).max() < 3e-4

    with legs.device:
        try:
            legs.start()
            assert machine.until(arrived, 60.0)
        finally:
            legs.stop()


@pytest.fixture
def run_with(here, capsys, in_time):
    """Runs a job in which devices misbehave while the legs move; how it ended."""

    before = here.wires.get("legs.extension")

    def run(kind, *parts, arguments=(), end=3.0):
        capsys.readouterr()
        with here.disturbed(kind, *parts) as instants, here.looked_at() as seen:
            code = main([*brief(end), *arguments])
            ended = here.now()
        lines = capsys.readouterr().err.splitlines()
        errors = [line for line in lines if line.startswith("parapod: error: ")]
        in_time(float(ended <= instants[0]), 1, f"runs that ended before: {errors}")
        begun, *neutral = instants
        return Ended(code, "\n".join(errors), ended - begun, sum(neutral, -begun), seen)

    yield run
    for part in here.disturbable:
        here.misbehave(part, "well")
    time.sleep(0.1)
    put_back(here, before)


# The others in `make test-all`.
SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("part", "kind", "words"),
    [
        ("imu", "off", r"ADIS16448 at unix:\S+/spi\.sock: does not answer"),
        # Silence, if the cable goes while an answer is on its way.
        ("wheels", "unplugged", r"EPOS2 on slcan \S+/can: (no bus|node 1 does not answer SYNC)"),
        pytest.param("imu", "garbage", r"ADIS16448 at \S+: .*0x[0-9A-F]{4}", marks=SLOW),
        pytest.param("imu", "intermittent", r"ADIS16448 at \S+: does not answer", marks=SLOW),
        pytest.param(
            *("imu", "unplugged", r"ADIS16448 at \S+: cannot (be reached|transfer)"), marks=SLOW
        ),
        pytest.param(
            *("wheels", "off", r"EPOS2 on slcan \S+/can: node 1 does not answer SYNC"), marks=SLOW
        ),
        pytest.param("wheels", "garbage", r"EPOS2 on slcan \S+/can: node \d .*", marks=SLOW),
    ],
)
def test_a_device_that_fails_is_named_and_leaves_the_machine_neutral_within_a_second(
    run_with, here, in_time, part, kind, words
):
    ended = run_with(kind, part)
    assert ended.code == 2
    assert re.fullmatch(rf"parapod: error: {words}.*", ended.error)
    assert ended.seen["voltage"] > 0.1
    assert here.is_neutral
    in_time(ended.neutral, 1.0, f"neutral after {part} {kind} [s]")
    # What does not answer at the end either is asked for two seconds more.
    in_time(ended.took, 4.0, f"end after {part} {kind} [s]")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "words"),
    [("off", r"did not answer within 0\.1 s"), ("unplugged", r"no NI gRPC .* can be reached")],
)
@pytest.mark.parametrize("watchdog_ms", [500, 0])
def test_a_card_that_is_away_opens_the_relay_or_holds_until_the_next_program(
    run_with, here, in_time, capsys, kind, words, watchdog_ms
):
    settings = ("timeout_ms=100", f"watchdog_ms={watchdog_ms}")
    overrides = (f"hardware.drivers.0.{setting}" for setting in settings)
    ended = run_with(kind, "legs", arguments=("--set", *overrides))
    assert ended.code == 2
    # The guard may find first that measurements are old.
    card = rf"(legs_stale: .*; )?PXIe-6363 PXI1Slot2 at \S+: .*{words}.*"
    assert re.fullmatch(rf"parapod: error: {card}", ended.error)
    # Nobody can reach it; the wheels are stopped all the same.
    assert here.has_power is (watchdog_ms == 0)
    assert here.wires.get("wheels.brake")[0] > 0.5
    here.misbehave("legs", "well")
    time.sleep(0.1)
    # Where the rods have gone meanwhile is not known, but they are stopped.
    assert main(["check", "legs"]) == 2
    assert "measure them" in capsys.readouterr().err
    assert here.is_neutral
    if watchdog_ms == 0:
        assert ended.error.endswith("MAY STILL BE LIVE: press the emergency stop")
    else:
        assert ended.error.endswith("without this program the card opens the relay within 0.5 s")
        assert "MAY STILL BE LIVE" not in ended.error
    in_time(ended.took, 4.0, f"end after the card was {kind} [s]")


@pytest.mark.parametrize(
    ("part", "kind", "words"),
    [
        ("legs", "stuck", "leg_response: a leg that does not move as its voltage says"),
        *(
            pytest.param(*row, marks=SLOW)
            for row in (
                ("legs", "wrong", "leg_response|encoder_jump"),
                ("legs", "slow", "leg_response"),
                ("legs", "delayed", "leg_response"),
                # Garbage on the line of the emergency stop is obeyed at once.
                ("legs", "garbage", "emergency_stop|leg_response|encoder_jump|encoder_invalid"),
                ("legs", "intermittent", "legs_stale|PXIe-6363 .* did not answer"),
                ("imu", "wrong", "accel_mismatch|posture_mismatch"),
                ("imu", "garbage", "imu_stale|ADIS16448 .*"),
                ("imu", "intermittent", "imu_stale|ADIS16448 .*"),
            )
        ),
    ],
)
def test_measurements_that_cannot_be_end_the_job_and_are_remembered_by_no_file(
    run_with, here, in_time, part, kind, words
):
    ended = run_with(kind, part)
    assert ended.code == 2
    assert re.fullmatch(rf"parapod: error: (?:{words}).*", ended.error)
    assert ended.seen["voltage"] > 0.1
    assert here.is_neutral
    if part == "legs":
        assert '"extension_m": null' in here.memory.path.read_text()
    in_time(ended.neutral, 1.0, f"neutral after {part} {kind} [s]")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "kind"),
    [("imu", "stuck"), ("imu", "slow"), ("imu", "delayed")]
    + [("wheels", kind) for kind in ("stuck", "wrong", "slow", "delayed", "intermittent")],
)
def test_after_a_run_with_devices_that_lie_the_machine_is_neutral(run_with, here, part, kind):
    ended = run_with(kind, part, end=1.5)
    assert ended.seen["voltage"] > 0.1
    assert here.is_neutral


@pytest.mark.parametrize("released_after", [pytest.param(None, marks=SLOW), 0.02])
def test_an_emergency_stop_ends_the_job_also_if_it_was_pressed_for_a_moment(
    here, capsys, in_time, tmp_path, released_after
):
    log = tmp_path / "stopped.mcap"
    before = here.wires.get("legs.extension")
    pressed, words = [], "emergency_stop: the emergency stop is pressed, or its wire is broken"

    def press():
        if here.until(lambda: here.has_power, 300.0):
            here.until_time(here.now() + LOOKED + 1.0)
            pressed.append(here.now())
            here.misbehave("emergency_stop", "pressed")
            if released_after is not None:
                here.until_time(here.now() + released_after)
                here.misbehave("emergency_stop", "released")

    hand = threading.Thread(target=press)
    hand.start()
    try:
        code = main([*brief(), "--log", str(log)])
        ended, said = here.now(), capsys.readouterr().err
        assert code == 2
        assert here.is_neutral
        # Where programs wait for the computer, devices seem silent before.
        if not pressed or "legs_stale" in said:
            in_time(1.0, 1.0, f"runs that ended before the stop: {said}")
        took = ended - pressed[0]
        assert words in said.splitlines()[-1]
        # The tick that has ended the job is the last one of its log.
        button = read_log(log).signals["legs.emergency_stop"][:, 0]
        assert button[-1] == 1.0
        assert not button[:-1].any()
    finally:
        hand.join()
        here.misbehave("emergency_stop", "released")
        time.sleep(0.1)
        put_back(here, before)
    in_time(took, 2.0, "end after the emergency stop [s]")


# --- what is refused


@pytest.mark.slow
@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["2.node_ids=[1, 2, 3, 9]"], r"node 9 does not answer; nodes that do: 1, 2, 3, 4"),
        (["0.product=PXIe-6361"], r"PXI1Slot2 is a PXIe-6363, not a PXIe-6361"),
        (
            [
                "0.outputs=Dev9/ao0:3",
                "0.counters=Dev9/ctr0:3",
                "0.inputs=Dev9/port0/line0:11",
                "0.relay=Dev9/port0/line12",
                "0.stop_input=Dev9/port0/line13",
            ],
            r"Dev9 .*-200220",
        ),
    ],
)
def test_wrong_addresses_are_refused_before_anything_has_power(here, capsys, overrides, words):
    with here.looked_at() as seen:
        changes = [f"hardware.drivers.{override}" for override in overrides]
        assert main([*brief(), "--set", *changes]) == 2
    line = capsys.readouterr().err
    assert re.fullmatch(rf"parapod: error: .*{words}.*\n", line)
    assert seen == {"power": False, "voltage": 0.0, "wheels": False}


@pytest.mark.slow
def test_an_emulator_that_one_device_refuses_says_so_in_one_line():
    # Of its own, because the other devices' processes would write to the program's stderr.
    command = (sys.executable, "-m", "parapod.sims", "emulate", "level", "--backend", "kinematic")
    refused = ("--set", "hardware.drivers.0.target=localhost:1")
    done = subprocess.run((*command, *refused), capture_output=True, text=True, timeout=300)
    assert done.returncode == 2
    assert done.stderr == (
        "parapod: error: !NiDaqLegs.target = localhost:1 is not an address of the emulator, "
        "which begin with emulator/\n"
    )


def test_a_second_emulator_in_the_same_folder_is_refused(here, capsys):
    assert main(["emulate", "level", "--backend", "kinematic"]) == 2
    assert "an emulator runs in" in capsys.readouterr().err
    assert main(["check", "imu", "--seconds", "0.1"]) in (0, 1)  # the first goes on


def test_a_request_that_makes_no_sense_is_answered_with_those_that_do(here):
    count = len(here.said)
    here.process.stdin.write("imu nonsense\n")
    assert here.until(lambda: len(here.said) > count, 5.0)
    assert all(kind in here.said[-1] for kind in KINDS)
    here.misbehave("imu", "well")


# --- self-tests


@pytest.mark.slow
@pytest.mark.parametrize("command", ["imu", "legs --move 2 --yes", "wheels --move 1 --yes"])
def test_parts_of_the_emulated_machine_pass_their_self_tests(here, in_time, capsys, command):
    code = main(["check", *command.split(), "--seconds", "0.5"])
    assert here.is_neutral
    in_time(code, 1, f"self-test of {command}")


@pytest.mark.slow
def test_a_self_test_finds_an_encoder_with_a_swapped_sign(here, capsys):
    here.misbehave("legs", "wrong")
    assert main(["check", "legs", "--move", "2", "--yes", "--seconds", "0.2"]) == 1
    out = capsys.readouterr().out
    assert re.search(r"wrong_sign +1 +<= 0 +BROKEN", out), out
    assert here.is_neutral


@pytest.mark.slow
def test_a_first_run_knows_the_extensions_of_a_machine_that_stands_elsewhere(
    emulate, monkeypatch, capsys
):
    # Counters begin at zero and nothing tells them: what is said of it must be of this machine.
    machine = emulate(
        "ground: {foot_heights_mm: [3.0, 0.0, -2.0, 0.0]}\njob: {initial_extension_mm: 405.0}\n"
    )
    try:
        monkeypatch.setenv("PARAPOD_EMULATOR", machine.environment["PARAPOD_EMULATOR"])
        true = machine.wires.get("legs.extension")
        assert true[:3] == pytest.approx((0.405,) * 3)
        assert abs(true[3] - 0.405) > 1e-4
        # How fast a busy computer reads is not asked here.
        assert main(["check", "legs", "--seconds", "0.1"]) in (0, 1)
        shown = re.search(r"^extension: (.*) \(", capsys.readouterr().out, re.MULTILINE)[1]
        assert [float(x) for x in shown.split(",")] == pytest.approx(true, abs=1.5e-5)
        # Without the file nobody does.
        machine.memory.path.unlink()
        assert main(["check", "legs", "--seconds", "0.1"]) == 2
        line = capsys.readouterr().err
        assert re.fullmatch(r"parapod: error: PXIe-6363 .*: the legs' .* are unknown: .*\n", line)
        assert "extension_at_start_mm" in line
        given = "hardware.drivers.0.extension_at_start_mm=[405, 405, 405, 405]"
        assert main(["check", "legs", "--seconds", "0.1", "--set", given]) in (0, 1)
    finally:
        machine.end()
