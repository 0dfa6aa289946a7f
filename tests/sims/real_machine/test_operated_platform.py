"""A person operates the emulated platform on a page, and lets go of it in several ways."""

import importlib.util
import json
import os
import re
import signal
import time
from pathlib import Path

import numpy as np
import pytest

for library in ("nidaqmx", "grpc", "canopen", "can", "serial", "mcap"):
    pytest.importorskip(library)

# The benchmarks' person: folders of tests are no package that could import it.
_spec = importlib.util.spec_from_file_location(
    "page", Path(__file__).parents[3] / "benchmarks" / "page.py"
)
_page = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_page)
Page = _page.Page


@pytest.fixture(scope="module")
def machine(emulate_on_wheels):
    return emulate_on_wheels()


@pytest.fixture
def operate(machine):
    """operate(*options): the program, and the page of a person who has opened it."""
    begun = []

    def begin(*options):
        program = machine.parapod("operate", "deploy", "--backend=hardware", *options)
        line = program.stderr.readline()
        assert line.startswith("open http"), line + program.stderr.read()
        page = Page(line.split()[1])
        begun.append((program, page))
        page.wait("transport")
        return program, page

    yield begin
    for program, page in begun:
        page.close()
        if program.poll() is None:
            program.send_signal(signal.SIGINT)
            program.communicate(timeout=600)
    assert machine.until(lambda: machine.is_neutral, 60.0)


def voltages(machine):
    return np.abs(machine.wires.get("legs.voltage"))


@pytest.fixture
def within(machine, in_time):
    """within(condition, limit, what): waits until something holds, no longer than that."""

    def wait(condition, limit, what):
        begun = time.monotonic()
        assert machine.until(condition, 60.0), what
        in_time(time.monotonic() - begun, limit, what)

    return wait


def still(machine, seconds):
    """Whether no leg moves for a time."""
    before = np.array(machine.wires.get("legs.extension"))
    time.sleep(seconds)
    return np.abs(machine.wires.get("legs.extension") - before).max() < 5e-5


@pytest.mark.slow  # simulated every day: tests/sims/levelling_platform/test_live.py
def test_an_operator_drives_lowers_stops_and_goes_on(machine, operate, within, tmp_path):
    log = tmp_path / "operated.mcap"
    program, page = operate("--log", str(log))
    page.held = "ahead"
    assert machine.until(lambda: machine.wires.get("wheels.velocity_command")[0] > 1.0, 60.0)
    page.held = ""
    within(lambda: not any(machine.wires.get("wheels.velocity_command")), 0.6, "let go")
    page.click("Go")
    page.wait("lower")
    time.sleep(0.5)
    assert voltages(machine).min() > 0.1
    # The emergency stop.
    machine.misbehave("emergency_stop", "pressed")
    within(lambda: not machine.has_power and not voltages(machine).any(), 0.2, "cut")
    page.wait("fault")
    assert any(text.startswith("emergency_stop: ") for text in page.state()["remarks"])
    page.click("Reset")  # in vain
    time.sleep(0.5)
    assert page.state()["state"] == "fault"
    machine.misbehave("emergency_stop", "released")
    time.sleep(0.5)
    assert page.state()["state"] == "fault"
    assert not machine.has_power
    assert not voltages(machine).any()
    page.click("Reset")
    page.wait("standby")
    assert still(machine, 0.3)
    page.held = "leg 2 down"
    before = np.array(machine.wires.get("legs.extension"))
    time.sleep(0.7)
    page.held = ""
    moved = np.array(machine.wires.get("legs.extension")) - before
    assert moved[1] < -5e-4
    assert np.abs(np.delete(moved, 1)).max() < 1e-4
    page.click("Stop")
    page.wait("retract")
    time.sleep(0.5)
    assert voltages(machine).max() > 0.1
    # The page is closed while legs move.
    page.is_open.clear()
    within(lambda: still(machine, 0.05), 0.55, "page closed")
    time.sleep(0.3)
    assert still(machine, 0.3)
    page.is_open.set()
    page.wait("fault")
    page.click("End")
    _, said = program.communicate(timeout=600)
    assert program.returncode == 0, said
    assert log.stat().st_size > 100_000


@pytest.mark.slow
def test_a_machine_whose_page_dies_holds_and_then_ends(machine, operate, within, in_time):
    program, page = operate()
    page.click("Go")
    page.wait("lower")
    time.sleep(0.5)
    children = f"/proc/{program.pid}/task/{program.pid}/children"
    with open(children) as file:
        (desk,) = [int(pid) for pid in file.read().split() if "lab.desk" in command_of(pid)]
    page.is_open.clear()
    begun = time.monotonic()
    os.kill(desk, signal.SIGKILL)
    within(lambda: still(machine, 0.05), 0.55, "page killed")
    _, said = program.communicate(timeout=600)
    assert program.returncode == 2
    assert "the operator's page is gone" in said
    in_time(time.monotonic() - begun, 10.0, "end after the page was killed [s]")


def command_of(pid):
    with open(f"/proc/{pid}/cmdline") as file:
        return file.read().replace("\0", " ")


@pytest.mark.slow
def test_the_whole_operation_is_carried_out_on_devices(machine, tmp_path):
    found = tmp_path / "found.json"
    options = ("--set", "drive.distance_m=0.3", "--json", str(found))
    machine.run_well("run", "deploy", "--backend=hardware", *options)
    metrics = json.loads(found.read_text())
    assert metrics["steps_left"] == metrics["findings"] == 0.0
    assert metrics["roll_error_deg"] < 0.2
    assert machine.until(lambda: machine.is_neutral, 60.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "kind", "words"),
    [
        ("legs", "stuck", "leg_response: |supply: "),
        ("imu", "garbage", "accel_invalid: |gyro_invalid: |ADIS16448"),
        ("emergency_stop", "pressed", "emergency_stop: "),
    ],
)
def test_a_fault_in_the_operation_is_named_and_ends_it(machine, part, kind, words):
    program = machine.parapod("run", "deploy", "--backend=hardware")
    assert machine.until(lambda: voltages(machine).min() > 0.1, 40.0)
    machine.misbehave(part, kind)
    _, said = program.communicate(timeout=600)
    machine.misbehave(part, "released" if part == "emergency_stop" else "well")
    machine.measure_legs()
    assert program.returncode == 2
    assert re.search(words, said.splitlines()[-1]), said
    assert machine.until(lambda: machine.is_neutral, 60.0)
