"""A person operates the emulated platform on a page, and lets go of it in several ways."""

import json
import os
import re
import signal
import threading
import time
import urllib.request

import numpy as np
import pytest

for library in ("nidaqmx", "grpc", "canopen", "can", "serial", "mcap"):
    pytest.importorskip(library)


class Page:
    """A person in front of a browser, for a program that asks for one.

    Attributes:
        origin: address of the page without its token.
        is_open: whether the page says that it is there.
        held: name of the button that is held; "": none.
    """

    def __init__(self, url):
        self.origin, token = url.split("/?token=")
        self._asked = f"page=me&token={token}"
        self.is_open, self.held = threading.Event(), ""
        self.is_open.set()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._speak, daemon=True)
        self._thread.start()

    def _speak(self):
        while not self._over.wait(0.05):
            if not self.is_open.is_set():
                continue
            try:
                urllib.request.urlopen(f"{self.origin}/beat?{self._asked}", timeout=2.0).close()
                if self.held:
                    self.send(hold=self.held, on=True, number=time.monotonic_ns())
            except OSError:
                return  # the program has ended

    def state(self):
        """Everything that the page shows."""
        with urllib.request.urlopen(f"{self.origin}/state?{self._asked}", timeout=5.0) as answer:
            return json.loads(answer.read())

    def send(self, **body):
        """Does something on the page."""
        data = json.dumps({"page": "me", **body}).encode()
        address = f"{self.origin}/?{self._asked}"
        request = urllib.request.Request(address, data, {"Origin": self.origin})
        urllib.request.urlopen(request, timeout=5.0).close()

    def click(self, name):
        """Clicks a button."""
        self.send(button=name)

    def wait(self, state, timeout=30.0):
        """Waits until the machine is in a state; says for how long [s].

        Raises:
            TimeoutError: it is in another one; has what the page shows.
        """
        begun = time.monotonic()
        while (shown := self.state())["state"] != state:
            if time.monotonic() > begun + timeout:
                raise TimeoutError(shown)
            time.sleep(0.02)
        return time.monotonic() - begun

    def close(self):
        """Leaves."""
        self._over.set()
        self._thread.join()


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
    page.is_open.clear()
    begun = time.monotonic()
    os.kill(machine.companion(program, "parapod.sims.lab.desk"), signal.SIGKILL)
    within(lambda: still(machine, 0.05), 0.55, "page killed")
    _, said = program.communicate(timeout=600)
    assert program.returncode == 2
    assert "the operator's page is gone" in said
    in_time(time.monotonic() - begun, 10.0, "end after the page was killed [s]")


@pytest.mark.slow
def test_a_chair_whose_page_dies_while_somebody_walks_stands(emulate_for, in_time):
    chair = emulate_for("walk")
    options = ("--backend=hardware", "--set", "begin=0.5")
    program = chair.parapod("operate", "chair-walk", *options)
    page = Page(program.stderr.readline().split()[1])
    try:
        page.held = "walk"
        speed = 2e-3
        assert chair.until(
            lambda: np.abs(chair.wires.get("legs.velocity_command")).max() > speed, 120.0
        )
        time.sleep(1.0)
        page.is_open.clear()
        os.kill(chair.companion(program, "parapod.sims.lab.desk"), signal.SIGKILL)
        begun = time.monotonic()
        assert chair.until(lambda: not any(chair.wires.get("legs.velocity_command")), 60.0)
        took = time.monotonic() - begun
        _, said = program.communicate(timeout=600)
    finally:
        program.kill()
        page.close()
    assert program.returncode == 2
    assert "the operator's page is gone" in said
    assert chair.until(lambda: chair.is_neutral, 1.0)
    in_time(took, 0.5, "page killed")


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
