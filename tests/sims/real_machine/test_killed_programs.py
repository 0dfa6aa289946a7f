"""Programs that are killed: what becomes of the machine, of the logs and of the next program."""

import itertools
import os
import re
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from parapod.sims.cli.arguments import MISTAKE
from parapod.sims.cli.main import main
from parapod.sims.output.logs.files import read_log

for library in ("nidaqmx", "grpc", "canopen", "can", "serial", "mcap"):
    pytest.importorskip(library)

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")

# Where programs may not have a priority, others delay heartbeats by more than a wheel bears, and
# resets by more than the card does.
PATIENT = ("hardware.drivers.2.heartbeat_timeout_ms=500", "hardware.drivers.0.watchdog_ms=500")
# A card of the M Series, which have no watchdog.
HOLDING = """
hardware:
  drivers:
    - !NiDaqLegs {product: PXIe-6259}
    - !Adis16448SpiImu {}
    - !Epos2Wheels {}
    - !NotFittedPart {part: arm}
"""
SERIAL = """
hardware:
  drivers:
    - !NiDaqEncoders {}
    - !SabertoothLegs {}
    - !Adis16448SpiImu {}
    - !Epos2Wheels {}
    - !NotFittedPart {part: arm}
"""
DRIVING = {
    "legs.voltage": [1.0, -1.0, 1.0, 0.0],
    "legs.stop": [0.0],
    "wheels.velocity_command": [2.0] * 4,
    "wheels.brake": [0.0],
}
HEIGHTS = itertools.cycle((485.0, 470.0))


def job(estimate_at=0.5):
    """A job whose legs move from then on, for some seconds."""
    return (
        *("run", "level", "--backend", "hardware", "--set", "job.waypoints=[]"),
        *("job.settled_after=0.5", "job.end=20", f"job.estimate_at={estimate_at}"),
        f"job.height_mm={next(HEIGHTS)}",
        "job.arm={start: 0, duration: 0.1, angle_deg: 1}",
        *PATIENT,
    )


@pytest.fixture(scope="module")
def analog(emulate_by_the_clock):
    """A machine whose legs are driven by analog outputs."""
    return emulate_by_the_clock()


@pytest.fixture(scope="module")
def holding(emulate_by_the_clock):
    """The first one with a card that has no watchdog."""
    return emulate_by_the_clock(HOLDING)


@pytest.fixture(scope="module")
def serial(emulate_by_the_clock):
    """A machine whose legs are driven over a serial line."""
    return emulate_by_the_clock(SERIAL)


@pytest.fixture
def machine(analog, monkeypatch):
    """The first of them, for a controller in this process."""
    analog.measure_legs()
    with analog.here(monkeypatch):
        yield analog
    if analog.process.poll() is None:
        main(["check", "legs", "--seconds", "0.1"])
        assert analog.is_neutral


def levelling(machine, *options):
    """`parapod run level` whose legs move."""
    program = machine.parapod(*job(), *options)
    assert machine.until(lambda: machine.has_power, 300.0), program.communicate()
    time.sleep(1.2)
    return program


def members(machine):
    """Processes of the emulator that live."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, group = path.read_text().rpartition(")")[2].split()[:3]
        except (OSError, ValueError):
            continue
        if int(group) == machine.process.pid and state not in "ZX":
            found.append(int(path.parent.name))
    return found


def killed(program):
    """Kills a program; the wall clock [s]."""
    at = time.time()
    program.kill()
    program.communicate()
    return at


# --- the controller ends ----------------------------------------------------------------------


@pytest.mark.parametrize("name", [pytest.param("SIGINT", marks=pytest.mark.slow), "SIGTERM"])
def test_a_controller_that_is_asked_to_end_leaves_the_machine_neutral(
    machine, stamped, in_time, skip_if_busy, name
):
    path = machine.directory / f"{name}.mcap"
    program = levelling(machine, "--log", path)
    at, began = time.time(), time.monotonic()
    program.send_signal(getattr(signal, name))
    _, said = program.communicate(timeout=600)
    took = time.monotonic() - began
    if program.returncode == MISTAKE:  # the guard has been quicker
        skip_if_busy(said)
    assert program.returncode == 130, said
    assert said.splitlines()[-1] == "parapod: interrupted"
    assert "Traceback" not in said
    assert machine.is_neutral
    stamps, stop, brake = machine.logged("legs.stop", "wheels.brake")
    neutral = machine.first(stamps, (stop[:, 0] > 0.5) & (brake[:, 0] > 0.5), at)
    # Whole, up to the signal.
    mcap_reader = pytest.importorskip("mcap.reader")
    with open(path, "rb") as stream:
        assert mcap_reader.make_reader(stream).get_summary() is not None
    stamps, *_ = stamped(path, "legs.extension")
    assert len(read_log(path).time) == len(stamps)
    # It has ended in peace: the next program knows where the rods are.
    assert main(["check", "legs", "--seconds", "0.1"]) in (0, 1)
    in_time(at - stamps[-1], 0.2, "last sample before the signal [s]")
    in_time(neutral, 1.0, f"neutral after {name} [s]")
    in_time(took, 2.0, f"end after {name} [s]")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "dead", "words"),
    [
        ("imu", 0.03, "imu_stale|ADIS16448"),
        ("legs", 0.03, "legs_stale|PXIe-6363"),
        ("wheels", 0.2, "EPOS2"),  # which the guard leaves to the watch over the devices
    ],
)
def test_the_loop_keeps_its_rate_while_a_bus_is_stalled(
    machine, stamped, in_time, part, dead, words, capsys
):
    path = machine.directory / f"{part}-off.mcap"
    with machine.disturbed("off", part, after=0.7):
        assert main([*job(), "--log", str(path)]) == 2
    assert re.search(f"parapod: error: ({words})", capsys.readouterr().err)
    stamps, age = stamped(path, "status.age")
    index = ("legs", "imu", "wheels").index(part)
    # Nothing new of that device for so long, and ticks all the while.
    assert age[-1, index] > dead
    # Since the last measurement.
    stalled = np.diff(stamps[stamps > stamps[-1] - age[-1, index]])
    assert len(stalled) >= dead / 0.01 / 2
    assert np.median(stalled) == pytest.approx(0.01, abs=2e-3)
    in_time(stalled.max(), 0.1, "longest pause of the loop [s]")


@pytest.mark.slow
def test_the_log_of_a_killed_controller_is_readable_up_to_the_last_second(machine, stamped):
    path = machine.directory / "killed.mcap"
    at = killed(levelling(machine, "--log", path))
    log = read_log(path)
    last = log.metadata["wall_time"] + log.time[-1]
    assert at - 1.0 < last < at + 0.1
    assert len(log.signals["legs.extension"]) == len(log.time) > 50
    assert np.abs(log.signals["legs.voltage"]).max() > 0.1
    stamps, *_ = stamped(path, "legs.extension")
    assert stamps[-1] > at - 1.0


def test_wheels_stop_and_the_card_opens_the_relay_when_the_controller_is_killed(
    machine, in_time, capsys
):
    driving = machine.driving(DRIVING)
    # One program at a time: a second one changes nothing.
    assert main(["check", "legs", "--seconds", "0.1"]) == 2
    words = rf"parapod: error: PXIe-6363 .*: process {driving.pid} has it open; end that .*\n"
    assert re.fullmatch(words, capsys.readouterr().err)
    at = killed(driving)
    time.sleep(0.5)
    stamps, speed, brake, voltage, stop = machine.logged(
        "wheels.velocity_command", "wheels.brake", "legs.voltage", "legs.stop"
    )
    before = (stamps > at - 0.2) & (stamps < at)
    # A busy computer may have kept heartbeats from the wheels, which stop rightly then; and
    # resets from the card.
    lost = (np.abs(speed[before] - 2.0) > 0.01).any() or (brake[before] > 0.5).any()
    lost = lost or (stop[before] > 0.5).any()
    in_time(float(lost), 1.0, "wheels or legs that stopped before the kill")
    stands = (speed == 0.0).all(axis=1) & (brake[:, 0] > 0.5)
    took = machine.first(stamps, stands, at)
    is_open = (voltage == 0.0).all(axis=1) & (stop[:, 0] > 0.5)
    opened = machine.first(stamps, is_open, at)
    moving = voltage[before][:, :3]
    np.testing.assert_allclose(moving, [[1.0, -1.0, 1.0]] * len(moving), atol=0.01)
    # The next program does not know where the rods are, but stops them.
    assert main(["check", "legs"]) == 2
    out, line = capsys.readouterr()
    assert "the watchdog of an earlier program had opened the relay; it is cleared\n" in out
    assert re.fullmatch(r"parapod: error: extensions' file .*: says that .*\n", line)
    assert "measure them, and delete the file" in line
    assert machine.is_neutral
    in_time(took, 0.2, "wheels stopped after the kill [s]")
    # As stated, after the timeout of 0.1 s; the log has a row in 10 ms.
    in_time(opened, 0.12, "relay open after the kill [s]")


@pytest.mark.slow
def test_outputs_of_a_card_without_a_watchdog_hold_when_the_controller_is_killed(
    holding, monkeypatch, capsys
):
    holding.measure_legs()
    at = killed(holding.driving(DRIVING))
    time.sleep(0.5)
    stamps, voltage, stop = holding.logged("legs.voltage", "legs.stop")
    # As documented: nothing tells the card that its program is gone.
    after = stamps > at
    np.testing.assert_allclose(voltage[after][:, :3], [[1.0, -1.0, 1.0]] * after.sum(), atol=0.01)
    assert (stop[after] < 0.5).all()
    assert holding.has_power
    # The next program stops them, and says that the card does not by itself.
    monkeypatch.setenv("PARAPOD_EMULATOR", holding.environment["PARAPOD_EMULATOR"])
    assert main(["check", "legs", "--scenario", *holding.scenario]) == 2
    out, line = capsys.readouterr()
    assert re.search(r"^PXIe-6259 .*: no watchdog of its own: .*-200662", out, re.MULTILINE)
    assert re.fullmatch(r"parapod: error: extensions' file .*: says that .*\n", line)
    assert holding.is_neutral


@pytest.mark.slow
def test_serial_drivers_stop_the_legs_when_the_controller_is_killed(serial, in_time):
    at = killed(serial.driving(DRIVING))
    time.sleep(0.5)
    stamps, voltage, speed, brake = serial.logged(
        "legs.voltage", "wheels.velocity_command", "wheels.brake"
    )
    before = (stamps > at - 0.2) & (stamps < at)
    lost = (np.abs(voltage[before][:, :3]) < 0.8).any()
    in_time(float(lost), 1.0, "legs that stopped before the kill")
    legs = serial.first(stamps, (voltage == 0.0).all(axis=1), at)
    wheels = serial.first(stamps, (speed == 0.0).all(axis=1) & (brake[:, 0] > 0.5), at)
    in_time(legs, 0.2, "legs stopped after the kill [s]")
    in_time(wheels, 0.2, "wheels stopped after the kill [s]")


# --- the emulator is killed: the last tests, there is none afterwards -----------------------


@pytest.mark.slow
def test_a_controller_whose_machine_is_gone_ends_and_names_a_device(machine, in_time):
    without = ("--set", "hardware.drivers.0.watchdog_ms=0")
    controller = machine.parapod(*job(estimate_at=20.0), *without)
    assert machine.until(lambda: machine.has_power, 300.0), controller.communicate()
    time.sleep(0.5)
    os.killpg(machine.process.pid, signal.SIGKILL)
    began = time.monotonic()
    _, said = controller.communicate(timeout=600)
    took = time.monotonic() - began
    assert controller.returncode == 2, said
    assert re.match(r"parapod: error: (PXIe-6363|ADIS16448|EPOS2) ", said.splitlines()[-1]), said
    assert "Traceback" not in said
    # Nobody has confirmed that anything stands, though asked for two seconds.
    assert said.splitlines()[-1].endswith("MAY STILL BE LIVE: press the emergency stop")
    in_time(took, 4.0, "end after the emulator was killed [s]")


@pytest.mark.slow
def test_processes_of_the_devices_end_with_the_emulator(serial):
    assert len(members(serial)) >= 5
    serial.process.kill()
    serial.process.wait()
    assert serial.until(lambda: not members(serial), 2.0), members(serial)
