"""Identification on the emulated platform: programs of their own, and what is adopted of it."""

import json
import re
import subprocess
import threading

import numpy as np
import pytest

from parapod.sims.levelling_platform.calibrate.recording import read_recording
from parapod.sims.levelling_platform.calibrate.scenario import CalibrateScenario

for library in ("nidaqmx", "grpc", "canopen", "can", "mcap"):
    pytest.importorskip(library)

pytestmark = pytest.mark.slow
PATIENT = ("hardware.drivers.2.heartbeat_timeout_ms=500", "hardware.drivers.0.watchdog_ms=500")
GAIN_ERROR = 0.1  # of the emulated machine


@pytest.fixture(scope="module")
def standing(emulate_on_level_ground):
    return emulate_on_level_ground()


def skip_if_late(log, stamped, what):
    """Skips where the emulated machine lost time, which looks like its gains."""
    stamps, extension = stamped(log, "legs.extension")
    assert len(extension) > 100
    # Written once every 10 ms of the machine's own time.
    late = stamps - stamps[0] - 0.01 * np.arange(len(stamps))
    lost = np.abs(late[30:] - late[:-30]).max()  # within 0.3 s, where a step begins or ends
    if lost > 0.04 or abs(late[-1]) > 0.1:
        pytest.skip(f"{what}: the emulated machine was up to {1e3 * lost:.0f} ms late")


def test_actuators_are_identified_within_the_bounds_and_adopted(
    emulate_gains, stamped, skip_if_busy, tmp_path
):
    machine = emulate_gains()
    result, lab = tmp_path / "found.json", tmp_path / "lab.yaml"
    lab.write_text("# our machine\nseed: 0\n")
    program = machine.parapod(
        *("run", "identify-actuators", "--backend", "hardware", "--json", result),
        *("--set", "steps.lowering_mm_s=6", *PATIENT),
    )
    _, said = program.communicate(timeout=600)
    if program.returncode == 2:
        skip_if_busy(said)
    assert program.returncode in (0, 1), said
    skip_if_late(machine.log, stamped, "identified gains")
    found = json.loads(result.read_text())
    gains = np.array(found["identified"]["control.actuator_gains"])
    true = 0.01 * (1.0 + np.random.default_rng(0).uniform(-GAIN_ERROR, GAIN_ERROR, 4))
    assert 100.0 * np.abs(gains / true - 1.0).max() < 1.0
    assert found["passed"], found["bounds"]
    assert "gain_error_loaded_percent" not in found
    # The platform stands, and the legs stay.
    extension = machine.wires.get("legs.extension")
    assert extension == pytest.approx((0.398,) * 4, abs=3e-3)
    assert machine.is_neutral
    adopted = machine.parapod("adopt", result, "--into", lab)
    told, _ = adopted.communicate(timeout=600)
    assert adopted.returncode == 0
    assert told.startswith("control.actuator_gains: null (default) -> [")
    assert lab.read_text().startswith("# our machine\nseed: 0\ncontrol:\n  actuator_gains: [")


def test_a_machine_on_its_feet_is_refused_and_does_not_move(standing, skip_if_busy):
    before = standing.wires.get("legs.extension")
    with standing.looked_at() as seen:
        program = standing.parapod("run", "identify-actuators", "--backend", "hardware")
        _, said = program.communicate(timeout=600)
    assert program.returncode == 2
    if "touches the ground" not in said:
        skip_if_busy(said)
    assert "leg 1 touches the ground; begin on the wheels" in said
    assert seen["voltage"] == 0.0
    assert standing.wires.get("legs.extension") == before


def test_slip_is_measured_by_encoders(standing, tmp_path):
    result = tmp_path / "slip.json"
    standing.run_well("run", "slip", "--backend", "hardware", "--json", result, "--set", *PATIENT)
    found = json.loads(result.read_text())
    assert found["actuator_slip_mm"] == pytest.approx(3.5, abs=0.2)
    assert "arm_slip_mm" not in found


def test_postures_are_followed_without_and_with_the_outer_loop(standing, tmp_path):
    result = tmp_path / "tracked.json"
    standing.run_well(
        *("run", "track-posture", "--backend", "hardware", "--json", result, "--set"),
        *("job.estimate_at=1", "job.settled_after=1.5", "job.end=9"),
        "job.waypoints=[{time: 1.5, height_mm: 3, pitch_deg: 0.5}]",
        *PATIENT,
    )
    found = json.loads(result.read_text())
    assert found["pitch_error_deg"] < 0.2
    assert found["outer_loop_pitch_error_deg"] < 0.05
    assert "gain_margin_dB" not in found


def read_off(machine):
    """Posture that somebody with an instrument reads beside the machine."""
    count = len(machine.said)
    machine.process.stdin.write("measure\n")
    machine.process.stdin.flush()
    assert machine.until(lambda: any("measured" in s for s in machine.said[count:]), 5.0)
    (line,) = [s for s in machine.said[count:] if "measured" in s]
    words = r"measured height ([\d.]+) mm, roll (-?[\d.]+) deg, pitch (-?[\d.]+) deg"
    return re.search(words, line).groups()


def test_the_machine_is_led_through_poses_and_asks_at_the_console(
    standing, skip_if_busy, tmp_path
):
    path = tmp_path / "poses.csv"
    program = standing.parapod(
        *("run", "calibrate", "--backend", "hardware", "--set", "poses.count=2"),
        "measuring={rest_s: 1, average_s: 0.5, rate_mm_s: 4}",
        *(f"measuring.poses_file={path}", *PATIENT),
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
    )
    said, read = [], []
    end = threading.Timer(600.0, program.kill)
    end.start()
    for line in program.stderr:
        said.append(line)
        if "is at rest" in line:
            assert set(standing.wires.get("legs.voltage")) == {0.0}
            if not read:
                program.stdin.write("no number\n")
                program.stdin.flush()
                read.append(None)
                continue
            read.append(read_off(standing))
            program.stdin.write(" ".join(read[-1]) + "\n")
            program.stdin.flush()
    end.cancel()
    program.wait(600.0)
    program.stdin.close()
    if len(read) < 3:
        skip_if_busy("".join(said))
    # Two poses are recorded, but too few to calibrate with.
    assert program.returncode == 2
    assert "the recording does not determine" in said[-1]
    recording = read_recording(path, CalibrateScenario())
    told = np.array(read[1:], dtype=float)
    assert recording.height == pytest.approx(1e-3 * told[:, 0])
    assert recording.reference == pytest.approx(np.radians(told[:, 1:]))
    assert recording.attitude == pytest.approx(recording.reference, abs=np.radians(0.15))
    assert recording.contact.all()
