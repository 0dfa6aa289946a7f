"""The experiment `inspect`: the tip comes to its points, by legs, turntable and arm together."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from parapod.diagrams.levelling_platform import pointing
from parapod.diagrams.levelling_platform.arms import FlexibleRod
from parapod.diagrams.levelling_platform.pointing import make_pointing_controller
from parapod.diagrams.levelling_platform.tip import observed_arm
from parapod.diagrams.recording import Recording
from parapod.diagrams.wiring import outputs_of
from parapod.sims.lab.discovery import find_entry
from parapod.sims.levelling_platform.inspection import Inspect, InspectScenario
from parapod.sims.levelling_platform.scene import TipScene
from parapod.sims.output.figures import render
from parapod.systems.arm import flexible_arm
from parapod.systems.arm.rod_motion import ClampMotion
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.core.vectors import Axes
from parapod.systems.levelling_platform.carried_arm import UnreachableTip

TWO = "inspection.points=[{place_mm: [1030, 20, 2360]}, {place_mm: [930, 1620, 1430]}]"
BRIEF = ("backend=kinematic", "job.settled_after=4", TWO)
# A machine as drawn, whose sensors are exact.
PERFECT = "machine.sensors={imu_noise: false, accel_bias_mg: 0, gyro_bias_deg_s: 0}"


@pytest.fixture(scope="module")
def found(execute):
    return execute("inspect", *BRIEF, PERFECT)


def test_the_tip_of_a_machine_as_drawn_is_within_two_millimetres(found):
    assert found.passed
    assert found["points_left"] == 0
    assert found["tip_error_mm"] < 2.0
    assert found["stroke_left_mm"] > 0.0
    assert 0.5 < found["time_per_point_s"] < 6.0


@pytest.mark.parametrize("backend", ["multibody", "mujoco"])
def test_so_it_is_on_bodies(execute, backend):
    if backend == "mujoco":
        pytest.importorskip("mujoco")
    settings = (f"backend={backend}", "job.settled_after=4", TWO)
    # 1.7 mm without the compliance of the arm's drives.
    assert execute("inspect", *settings, PERFECT)["tip_error_mm"] < 1.2


def test_a_machine_with_errors_keeps_its_wider_bound(execute):
    errors = ("plant.length_error_mm=0.5", "plant.angle_error_deg=0.1", "seed=3")
    found = execute("inspect", *BRIEF, *errors)
    assert found.passed
    assert 0.5 < found["tip_error_mm"] < 10.0


def test_shaped_moves_leave_the_rod_nearly_at_rest(execute, found):
    unshaped = execute("inspect", *BRIEF, PERFECT, "control.arm_shaper=none")
    assert found["residual_mm"] < 0.1 * unshaped["residual_mm"]


@pytest.fixture(scope="module")
def recorded():
    """All signals of such a run."""
    default = find_entry("inspect").default_scenario
    scenario = load_scenario(InspectScenario, default, None, (*BRIEF, PERFECT))
    loop = Inspect("inspect").loop(scenario)
    simulator = Simulator(loop)
    simulator.AdvanceTo(14.0)
    return scenario, loop.recording(simulator.get_context())


def test_the_rod_is_observed_as_it_bends_and_rests_before_the_ground_is_known(recorded):
    _, recording = recorded
    observed, true = recording["tip_deflection_observed"], recording["truth.tip_deflection"]
    is_known = recording["ground_valid"][:, 0] > 0.5
    assert not is_known[0]
    assert not observed[~is_known].any()
    assert not recording["rod_observed"][~is_known].any()
    missed = np.linalg.norm(observed - true, axis=1)
    # The first estimate of the ground finds a rod at rest: no jump makes it swing.
    assert missed[np.flatnonzero(is_known)[2:20]].max() < 1.5e-3
    assert np.ptp(true[:, 0]) > 0.05
    assert missed[is_known].max() < 0.1 * np.ptp(true[:, 0])


def softer(scenario, payload=0.0):
    """An observer of a rod that is three quarters as stiff."""
    other = copy.deepcopy(scenario)
    other.machine.arm.bending_stiffness_Nm2 = [320.0, 320.0]
    return observed_arm(other, payload)


def unmoved(scenario, payload=0.0):
    """An observer of a rod that follows its weight alone."""
    real = flexible_arm._moved

    def moved(*arguments):
        ahead = real(*arguments)
        weight = Axes.from_quaternion(ahead.numbers[:4]).components((0.0, 0.0, GRAVITY))
        return ahead._replace(motion=ClampMotion(weight))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flexible_arm, "_moved", moved)
        return observed_arm(scenario, payload)


@pytest.mark.parametrize("wrong", [softer, unmoved])
def test_an_observer_that_is_wrong_breaks_its_bound(execute, monkeypatch, wrong):
    monkeypatch.setattr(pointing, "observed_arm", wrong)
    found = execute("inspect", *BRIEF, PERFECT)
    assert [metric.key for metric in found.broken] == ["observed_error_mm"]


def test_a_rigid_arm_and_one_too_fast_for_the_controller_have_no_observer():
    rigid = load_scenario(InspectScenario, overrides=("machine.arm=!Rod {}",))
    stiff = "machine.arm=!FlexibleRod {bending_stiffness_Nm2: [4.0e+6, 4.0e+6]}"
    for scenario in (rigid, load_scenario(InspectScenario, overrides=(stiff,))):
        assert observed_arm(scenario) is None
        assert "rod_observed" not in outputs_of(make_pointing_controller(scenario))


def test_modes_that_the_controllers_period_does_not_carry_are_left_out():
    def count(period):
        settings = "machine.arm=!FlexibleRod {modes: 3}", f"control.period={period}"
        controller = make_pointing_controller(load_scenario(InspectScenario, overrides=settings))
        return outputs_of(controller)["rod_observed"].size()

    assert count(0.005) > count(0.02) >= 4


def test_a_real_machine_without_an_arm_is_refused(execute):
    unfit = "hardware.drivers=[!NiDaqLegs {}, !Adis16448SpiImu {}, !Epos2Wheels {}, "
    with pytest.raises(ScenarioError, match="an arm must be fitted") as caught:
        execute("inspect", "backend=hardware", f"{unfit}!NotFittedPart {{part: arm}}]")
    assert caught.value.key == "hardware.drivers"


class Real(Recording):
    """A run on a real machine, without truth."""

    realtime_factor = 1.0

    def __init__(self, run):
        measured = {n: x for n, x in run.signals.items() if not n.startswith("truth.")}
        super().__init__(run.time, measured, run.units)


def test_what_is_measured_takes_the_place_of_what_is_true(recorded, found):
    scenario, recording = recorded
    scenario, real = replace(scenario, backend="hardware"), Real(recording)
    inspect = Inspect("inspect")
    metrics = {metric.key: metric.value for metric in inspect.measure(scenario, real)}
    assert "observed_error_mm" not in metrics
    assert metrics["points_left"] == 0
    for key, most in (("tip_error_mm", 2.0), ("residual_mm", 5.0), ("stroke_left_mm", 0.1)):
        assert metrics[key] == pytest.approx(found[key], abs=most)
    for figure in inspect.draw(scenario, real):
        assert render(figure).startswith(b"<?xml")
    assert "observer" in " ".join(inspect.note(scenario, real))


@pytest.mark.parametrize(
    ("place", "error", "words"),
    [
        ([2400, 0, 1000], UnreachableTip, "the nearest point that it reaches"),
        ([0, 0, 400], UnreachableTip, "does not reach"),
    ],
)
def test_a_point_out_of_reach_is_refused(execute, place, error, words):
    point = f"inspection.points=[{{place_mm: {place}}}]"
    with pytest.raises(error, match=words):
        execute("inspect", *BRIEF[:2], point)


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        (("machine.arm=!None {}",), "machine.arm"),
        (("inspection.points=[]",), "inspection.points"),
        (
            ("inspection.points=[{place_mm: [1030, 20, 2360], view: [0, 0, 0]}]",),
            "inspection.points.0.view",
        ),
        (
            (
                "inspection.points=[{place_mm: [1030, 20, 2360]}, "
                "{place_mm: [930, 1620, 1430], view: [0, 0, 1]}]",
            ),
            "inspection.points",
        ),
    ],
)
def test_what_cannot_be_inspected_is_refused_before_anything_moves(execute, settings, key):
    with pytest.raises(ScenarioError) as caught:
        execute("inspect", "backend=kinematic", "control.arm_shaper=none", *settings)
    assert caught.value.key == key


def test_a_run_that_ends_before_the_first_point_says_so(execute):
    found = execute("inspect", *BRIEF, "inspection.longest_s=2")
    assert {metric.key for metric in found.broken} >= {"points_left", "tip_error_mm"}
    assert found["points_left"] == 2
    for figure in found.figures:
        assert render(figure).startswith(b"<?xml")


def test_points_and_way_are_drawn():
    meshcat = Meshcat()
    scene = TipScene(meshcat, [(1.0, 0.0, 2.0), (0.0, 1.0, 2.0)])
    assert meshcat.HasPath("/tip/points/1")
    scene.show([np.nan] * 3, (0.0, 0.0, 2.6), 0.0)
    assert not meshcat.HasPath("/tip/way")
    for k in range(3):
        scene.show((1.0, 0.0, 2.0), (0.1 * k, 0.0, 2.6), 0.2 * k)
    assert meshcat.HasPath("/tip/way/1")
    assert meshcat.HasPath("/tip/goal/1")


def test_sliders_lead_the_tip():
    """A person's loop has sliders for three axes, and clamps what cannot be reached."""

    scenario = InspectScenario(backend="kinematic")
    scenario.machine.arm = FlexibleRod()
    meshcat = Meshcat()
    loop = Inspect("inspect").operated(scenario, meshcat)
    sliders = loop.GetSubsystemByName("tip_sliders")
    simulator = Simulator(loop)
    with sliders.shown():
        assert len(meshcat.GetSliderNames()) == 3
        meshcat.SetSliderValue("tip x [mm]", 1030.0)
        meshcat.SetSliderValue("tip z [mm]", 2360.0)
        simulator.AdvanceTo(8.0)
    goal = loop.controller.GetOutputPort("tip_goal").Eval(
        loop.controller.GetMyContextFromRoot(simulator.get_context())
    )
    np.testing.assert_allclose(goal, [1.03, 0.023, 2.36], atol=0.05)
