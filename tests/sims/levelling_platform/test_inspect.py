"""The experiment `inspect`: the tip comes to its points, by legs, turntable and arm together."""

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from parapod.diagrams.levelling_platform.arms import FlexibleRod
from parapod.sims.levelling_platform.inspection import Inspect, InspectScenario
from parapod.sims.levelling_platform.scene import TipScene
from parapod.sims.output.figures import render
from parapod.systems.core.errors import ScenarioError
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
