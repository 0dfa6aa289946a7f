"""The arm's tip put to points on the emulated platform, by programs of their own."""

import json

import numpy as np
import pytest

from parapod.sims.cli.main import main
from parapod.sims.output.logs.files import read_log

for library in ("nidaqmx", "grpc", "canopen", "can", "mcap"):
    pytest.importorskip(library)

pytestmark = pytest.mark.slow
# As in `test_emulated_platform`: where programs may not have a priority, others delay them.
PATIENT = (
    "hardware.drivers.0.watchdog_ms=500",
    *(f"hardware.drivers.{i}.heartbeat_timeout_ms=500" for i in (2, 3)),
)
POINTS = np.array([[1.03, 0.02, 2.36], [0.93, 1.62, 1.43]])
LIST = ", ".join(f"{{place_mm: {(1e3 * point).tolist()}}}" for point in POINTS)


@pytest.fixture(scope="module")
def machine(emulate_inspection):
    return emulate_inspection()


def test_the_tip_comes_to_its_points_and_the_rod_is_observed(machine, tmp_path):
    log, result = tmp_path / "inspected.mcap", tmp_path / "inspected.json"
    machine.run_well(
        *("run", "inspect", "--backend", "hardware", "--log", log, "--json", result, "--set"),
        *("job.settled_after=4", "inspection.longest_s=60", f"inspection.points=[{LIST}]"),
        *PATIENT,
    )
    found = json.loads(result.read_text())
    assert found["points_left"] == 0
    # Of a machine without truth the observer tells the vibration, and none how wrong it is.
    assert 0.0 < found["residual_mm"] < 15.0
    assert "observed_error_mm" not in found
    _, pose = machine.logged("truth.tip_pose")
    for point in POINTS:
        assert np.linalg.norm(pose[:, 4:] - point, axis=1).min() < 0.01
    assert machine.is_neutral
    recording = read_log(log).signals
    _, true = machine.logged("truth.tip_deflection")
    observed = recording["tip_deflection_observed"]
    assert not observed[recording["ground_valid"][:, 0] < 0.5].any()
    for most in (np.min, np.max):
        assert most(observed, axis=0) == pytest.approx(most(true, axis=0), abs=0.018)


def test_a_self_test_turns_one_joint_of_the_arm(machine, monkeypatch):
    begin = len(machine.logged("arm.position")[0])
    with machine.here(monkeypatch):
        here = ("--of", "inspect", "--move", "1", "--yes", "--seconds", "0.5")
        assert main(["check", "arm", *here]) in (0, 1)
    turned, still = np.ptp(machine.logged("arm.position")[1][begin:], axis=0)
    assert turned > 0.01
    assert still < 1e-3
