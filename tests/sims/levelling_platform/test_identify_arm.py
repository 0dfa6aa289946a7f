"""The experiment `identify-arm`: the rod's vibration by the legs alone, and its use."""

import math

import numpy as np
import pytest

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.levelling_platform.identify_arm import IdentifyArm, request_of
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.levelling_platform.kinematics import forward_kinematics

SOFTER = "machine.arm.bending_stiffness_Nm2=[300,420]"
BRIEF = ("backend=kinematic", "job.settled_after=3.5", "job.arm.start=3.5", "job.end=6.5")


@pytest.fixture(scope="module")
def softer(execute):
    return execute("identify-arm", "backend=kinematic", SOFTER)


def test_both_planes_are_identified_through_noise(softer):
    assert softer.passed
    assert softer["pitch_frequency_error_percent"] < 1.5
    assert softer["roll_frequency_error_percent"] < 1.5
    # The inertial sensor alone would not do.
    for axis in ("pitch", "roll"):
        assert softer[f"{axis}_signal_to_noise"] > 2.0 * softer[f"{axis}_gyro_signal_to_noise"]


def test_what_is_identified_is_what_shapers_need(softer, execute):
    values = softer.identified
    assert values["control.arm_frequencies_Hz"] == sorted(values["control.arm_frequencies_Hz"])
    assert 0.0 <= values["control.arm_damping_ratio"] < 0.03
    known = [f"{key}={value}" for key, value in values.items()]
    drawn = "control.arm_frequencies_Hz=[2.2]"
    broken = {metric.key for metric in execute("arm-vibration", *BRIEF, SOFTER, drawn).broken}
    assert {"zv_residual_percent", "legs_residual_percent"} <= broken
    assert execute("arm-vibration", *BRIEF, SOFTER, "job.end=7.5", *known).passed


def test_planes_that_are_alike_have_one_frequency(execute):
    found = execute("identify-arm", "backend=kinematic", "seed=1")
    assert found.passed
    assert len(found.identified["control.arm_frequencies_Hz"]) == 1


def scenario_with(*overrides):
    usual = ("machine.arm=!FlexibleRod {}", "ground={roll_deg: 0, pitch_deg: 0}")
    return load_scenario(LevellingScenario, overrides=(*usual, *overrides))


def test_the_request_tilts_by_each_axis_in_turn_and_stays_inside_the_stroke():
    scenario = scenario_with()
    request = request_of(scenario)
    times = np.arange(0.0, IdentifyArm("identify-arm").duration(scenario), 0.01)
    extensions = request.vector_values(times).T
    geometry = scenario.geometry_as_known
    assert extensions.min() > geometry.extension_min
    assert extensions.max() < geometry.extension_max
    tilts = np.degrees(forward_kinematics(geometry, extensions, [0.0, 0.0], (0, 1, 2))[:, :2])
    assert tilts.max(axis=0) == pytest.approx([1.2, 1.2], abs=1e-3)
    assert np.abs(tilts).min(axis=1).max() < 1e-6
    rates = np.gradient(extensions, times, axis=0)
    assert np.abs(rates).max() < scenario.machine.actuators.max_speed
    assert math.isclose(request.start_time(), 0.0)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("machine.arm=!Rod {}",), r"machine.arm must bend"),
        (("ground.roll_deg=2",), r"ground.roll_deg and ground.pitch_deg must be 0"),
    ],
)
def test_machines_that_tell_nothing_are_refused(execute, settings, words):
    with pytest.raises(ScenarioError, match=words):
        execute("identify-arm", "backend=kinematic", *settings)
