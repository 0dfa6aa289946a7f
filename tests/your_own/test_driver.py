"""The driver that the documents show, at the other end of a line, and drivers that are broken."""

import math
import os
import pty
import sys
import threading
import time
import tty
from functools import partial
from pathlib import Path

import pytest

from parapod.diagrams.drivers.driver import PartPorts
from parapod.diagrams.drivers.external import load_drivers
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.cli.main import main
from parapod.sims.lab.discovery import find_entry
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.hardware.device import DeviceError

PAGE = Path(__file__).parents[2] / "docs" / "your_own" / "driver.md"
LEVEL = find_entry("level")


class Arm(threading.Thread):
    """The other end of the line of the driver that the documents show."""

    def __init__(self, answer):
        super().__init__(daemon=True)
        self.answer, self.lines = answer, []
        self.ours, theirs = pty.openpty()
        tty.setraw(theirs)
        self.port = os.ttyname(theirs)
        self._theirs = theirs
        self.start()

    def run(self):
        buffer = b""
        while True:
            try:
                buffer += os.read(self.ours, 100)
            except OSError:
                return
            while b"\n" in buffer:
                line, _, buffer = buffer.partition(b"\n")
                self.lines.append(line)
                if line == b"?":
                    os.write(self.ours, self.answer + b"\n")


@pytest.fixture
def my_arm(reader_of, monkeypatch):
    serial = pytest.importorskip("serial")
    # The other end of its line is a thread, which may be late.
    patient = partial(serial.Serial, **dict.fromkeys(("timeout", "write_timeout"), 60.0))
    monkeypatch.setattr(serial, "Serial", lambda port, baud, **_: patient(port, baud))
    path = reader_of(PAGE) / "my_arm.py"
    assert len([line for line in path.read_text().splitlines() if line.strip()]) <= 42
    load_drivers(path)
    return sys.modules["my_arm"]


def test_the_driver_that_is_shown_can_be_named_in_a_scenario(my_arm):
    file, default = Path("lab.yaml"), LEVEL.default_scenario
    scenario = load_scenario(LevellingScenario, default, file)
    driver, *others = scenario.hardware.drivers
    assert driver == my_arm.MyArm("arm", "/dev/ttyUSB2", 30.0)
    assert {driver.part, *(other.part for other in others)} >= set(PLATFORM.parts)
    with pytest.raises(ScenarioError, match=r"limit_deg = 300 is outside 0..180"):
        load_scenario(LevellingScenario, default, file, ["hardware.drivers.0.limit_deg=300"])


def test_the_driver_that_is_shown_works(my_arm):
    arm = Arm(b"ARM1")
    device = my_arm.MyArm(port=arm.port, limit_deg=30.0).make(PartPorts({}, {}))
    with device:
        for angle in (0.1, math.nan, 10.0):
            device.write({"position_command": (0.2, angle)})
        end = time.monotonic() + 60.0
        while len(arm.lines) < 3 and time.monotonic() < end:
            time.sleep(0.01)
    assert arm.lines == [b"?", b"P 11.46 5.73", b"P 11.46 30.00"]


def test_the_check_that_is_shown_says_that_the_arm_answers_and_shows_nothing(my_arm, capsys):
    port = f"hardware.drivers.0.port={Arm(b'ARM1').port}"
    assert main(["check", "arm", "--scenario", "lab.yaml", "--set", port]) == 0
    said = capsys.readouterr().out
    assert "arm on /dev/pts/" in said
    assert said.endswith("arm measures nothing: that its devices answer is all that was checked\n")
    assert "bounds held" not in said


def test_the_driver_that_is_shown_refuses_what_is_no_arm(my_arm):
    with pytest.raises(DeviceError, match="not ARM1"):
        my_arm.MyArm(port=Arm(b"MODEM").port).make(PartPorts({}, {})).configure()
    with pytest.raises(DeviceError, match="/dev/none"):
        my_arm.MyArm(port="/dev/none").make(PartPorts({}, {})).configure()


def test_drivers_that_cannot_be_imported_are_refused(tmp_path):
    with pytest.raises(ScenarioError, match="there is no such Python file"):
        load_drivers(tmp_path / "none.py")
    path = tmp_path / "broken_lab_drivers.py"
    path.write_text("1 / 0\n")
    with pytest.raises(ScenarioError, match=r"broken_lab_drivers\.py' cannot be imported"):
        load_drivers(path)
