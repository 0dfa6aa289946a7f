"""The experiment `arm-vibration`: shapers leave the tip at rest, of a known rod and of others."""

import pytest

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.shaping import arm_shaper
from parapod.sims.levelling_platform.arm_vibration import simulated_residual
from parapod.systems.arm.input_shaper import Shaper
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import load_scenario

BRIEF = ("backend=kinematic", "job.settled_after=3.5", "job.arm.start=3.5", "job.end=6.5")


def scenario_with(*overrides):
    flexible = "machine.arm=!FlexibleRod {}"
    return load_scenario(LevellingScenario, overrides=(flexible, *overrides))


@pytest.fixture(scope="module")
def found(execute):
    return execute("arm-vibration", *BRIEF)


def test_every_shaper_leaves_five_percent_of_the_vibration(found):
    assert found.passed
    assert 60.0 < found["unshaped_residual_mm"] < 80.0
    assert found["zvd_residual_percent"] < found["zv_residual_percent"] < 2.0
    # EI is designed to leave its tolerance.
    assert found["ei_residual_percent"] == pytest.approx(4.0, abs=0.4)


def test_shapers_delay_by_half_a_period_or_a_whole_one(found):
    period = 1.0 / 2.2
    assert found["zv_delay_s"] == pytest.approx(0.5 * period + 0.01, abs=2e-3)
    assert found["zvd_delay_s"] == pytest.approx(period + 0.01, abs=2e-3)


def test_shaper_for_another_frequency_breaks_the_bound(execute):
    found = execute("arm-vibration", *BRIEF, "control.arm_frequencies_Hz=[3.3]")
    assert "zv_residual_percent" in {metric.key for metric in found.broken}


@pytest.mark.parametrize("kind", ["zv", "zvd", "ei"])
@pytest.mark.parametrize("scale", [0.8, 1.2])
def test_simulated_residual_of_another_rod_is_that_of_theory(kind, scale):
    scenario = scenario_with(f"control.arm_shaper={kind}")
    shaper = arm_shaper(scenario)
    omega = scenario.machine.arm.bending.loaded_frequencies(9.81)[0, 0]
    expected = 100.0 * float(shaper.residual(scale * omega, 0.005))
    # The rod that leans is a little stiffer than the upright one, for which shapers are designed.
    assert simulated_residual(scenario, shaper, scale) == pytest.approx(expected, abs=2.5)


def test_unshaped_command_has_no_shaper_and_all_of_the_vibration():
    scenario = scenario_with()
    assert arm_shaper(scenario) is None
    assert simulated_residual(scenario, Shaper(), 1.1) == pytest.approx(100.0)


def test_planes_of_other_stiffness_are_both_shaped():
    softer = "machine.arm.bending_stiffness_Nm2=[430, 250]"
    both = arm_shaper(scenario_with("control.arm_shaper=zv", softer))
    one = arm_shaper(scenario_with("control.arm_shaper=zv"))
    assert (len(one.times), len(both.times)) == (2, 4)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("machine.arm=!Rod {}",), r"machine.arm must bend"),
        (("control.arm_shaper=none",), r"control.arm_shaper must be one of zv, zvd, ei"),
        (("job.end=4.6",), r"job.end = 4.6 s is too early: .* measured until"),
        (("control.arm_frequencies_Hz=[80]",), r"control.arm_frequencies_Hz: .* below 50 Hz"),
    ],
)
def test_jobs_without_a_vibration_to_measure_are_refused(execute, settings, words):
    with pytest.raises(ScenarioError, match=words):
        execute("arm-vibration", *BRIEF, *settings)


def test_a_rigid_arm_is_shaped_for_frequencies_that_are_given():
    rigid = load_scenario(LevellingScenario, overrides=("control.arm_shaper=zv",))
    with pytest.raises(ScenarioError, match=r"arm_frequencies_Hz must be given: the arm .* rigid"):
        arm_shaper(rigid)
    known = ("control.arm_shaper=zv", "control.arm_frequencies_Hz=[2]")
    shaper = arm_shaper(load_scenario(LevellingScenario, overrides=known))
    assert shaper.delay == pytest.approx(0.25)
