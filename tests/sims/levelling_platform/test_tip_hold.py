"""The tip held in a point while disturbances come."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.sims.lab.discovery import find_entry
from parapod.sims.levelling_platform.tip_hold import TipHoldScenario
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.levelling_platform.pointing import TipLoop

SINKING = "disturbances=[!Subsidence {at: 15, foot: 3, depth_mm: 10}]"
EXACT = "machine.sensors={imu_noise: false, accel_bias_mg: 0, gyro_bias_deg_s: 0}"
RIGID = ("machine.arm=!Rod {}", "control.arm_shaper=none")


@pytest.fixture
def held(execute):
    """held(*settings): result on the kinematic backend, if no other is named."""

    def run(*settings, backend="kinematic", end=25.0):
        return execute("tip-hold", f"backend={backend}", f"hold.end_s={end}", *settings)

    return run


def test_the_tip_comes_back_where_ground_gives_way(held):
    result = held(*RIGID, EXACT, SINKING)
    assert result.passed
    assert result["tip_error_mm"] < 2.0
    assert result["excursion_mm"] > 10.0
    assert result["recovery_s"] < 3.0


def test_disturbances_may_come_at_once(held):
    both = "disturbances=[!Subsidence {at: 15, foot: 3}, !Payload {at: 15}]"
    assert held(*RIGID, EXACT, both).passed


def test_without_the_loop_it_stays_away(held, monkeypatch):
    monkeypatch.setattr(TipLoop, "_moved", lambda self, context, correction, missed: correction)
    result = held(*RIGID, EXACT, SINKING)
    assert {metric.key for metric in result.broken} == {"tip_error_mm", "recovery_s"}


@pytest.mark.parametrize("told", [True, False])
def test_a_payload_lowers_the_tip_of_a_rod_that_bends_unless_it_is_told(held, told):
    payload = "disturbances=[!Payload {at: 15, mass_kg: 0.5, duration: 2.0}]"
    result = held(EXACT, payload, f"hold.payload_is_told={str(told).lower()}", end=28.0)
    assert result.passed == told
    if told:
        assert result["tip_error_mm"] < 3.0
    else:
        # Half a kilogram at the end of a tube that leans by 50 deg.
        assert 15.0 < result["tip_error_mm"] < 31.0


@pytest.mark.parametrize("told", [True, False])
def test_the_observer_bends_its_rod_by_a_payload_that_it_is_told(told):
    experiment = find_entry("tip-hold")
    payload = "disturbances=[!Payload {at: 13, mass_kg: 0.5, duration: 1.0}]"
    overrides = ("backend=kinematic", EXACT, payload, f"hold.payload_is_told={str(told).lower()}")
    scenario = load_scenario(TipHoldScenario, experiment.default_scenario, None, overrides)
    loop = experiment.load().loop(scenario)
    simulator = Simulator(loop)
    simulator.AdvanceTo(16.0)
    recording = loop.recording(simulator.get_context())
    observed, true = recording["tip_deflection_observed"], recording["truth.tip_deflection"]
    before, after = recording.time < 13.0, recording.time > 15.0
    missed = np.linalg.norm(observed - true, axis=1)
    assert np.ptp(true[before | after, 0]) > 0.015
    assert missed[before].max() < 6e-3
    assert (missed[after].max() < 8e-3) == told


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["multibody", "mujoco"])
def test_on_bodies_it_comes_back_from_all_of_them(held, backend):
    if backend == "mujoco":
        pytest.importorskip("mujoco")
    reduced = "plant={leg_model: reduced, time_step: 0.0025}"
    both = "disturbances=[!Subsidence {at: 15, foot: 3}, !Payload {at: 22}]"
    assert held(reduced, both, backend=backend, end=30.0).passed


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (("disturbances=[]",), "disturbances must have 1 element or more"),
        (("machine.arm=!None {}",), "machine.arm must be an arm: its tip is put to points"),
        (
            ("hold.end_s=40",),
            "disturbances.2.at = 50 s must be 39.4 or less: the run ends 0.6 s after that",
        ),
    ],
)
def test_what_holds_no_tip_is_refused(settings, message):
    entry = find_entry("tip-hold")
    experiment = entry.load()
    scenario = load_scenario(experiment.schema, entry.default_scenario, None, settings)
    with pytest.raises(ScenarioError) as refusal:
        experiment.check(scenario)
    assert str(refusal.value) == message
