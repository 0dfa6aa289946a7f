"""Ground that gives way under feet, on every machine that stands."""

from pathlib import Path

import numpy as np
import pytest

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.machine import find_machine
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.machining_centre.platform_mode import leg_lengths
from tests.diagrams.test_pushes import loop_of, shown

HEXAPOD = Path(__file__).parents[2] / "examples/mechanisms/hexapod/hexapod.urdf"
FEET = np.array(((300.0, 0.0, -30.0), (-150.0, 260.0, -30.0), (-150.0, -260.0, -30.0)))


def sinking(*feet, depth=5.0):
    return str([f"!Subsidence {{at: 0.3, foot: {i}, depth_mm: {depth}}}" for i in feet]).replace(
        "'", ""
    )


@pytest.mark.parametrize("backend", ["multibody", "mujoco"])
def test_a_chair_goes_down_with_the_ground_under_all_of_its_feet(backend):
    if backend == "mujoco":
        pytest.importorskip("mujoco")
    loop = loop_of("walking_chair", sinking(1, 2, 3, 4), f"backend={backend}")
    signals = shown(loop, (0.3, 1.4))
    way = np.diff(signals["truth.body_position"], axis=0)[0]
    np.testing.assert_allclose(way, (0.0, 0.0, -5e-3), atol=5e-6)
    np.testing.assert_allclose(np.diff(signals["truth.foot_height"], axis=0), 0.0, atol=5e-6)
    np.testing.assert_allclose(signals["truth.ground_rise"], [[0.0] * 4, [-5e-3] * 4], atol=1e-9)
    force = signals["truth.contact_force"].sum(axis=1)
    assert force[1] == pytest.approx(force[0], rel=1e-3)


@pytest.mark.parametrize("backend", ["multibody", "mujoco"])
def test_a_chair_rocks_when_the_ground_rises_under_a_foot(backend):
    """On two feet of a diagonal, since four are too many; these are plates, and bear moments."""
    if backend == "mujoco":
        pytest.importorskip("mujoco")
    loop = loop_of("walking_chair", sinking(1, depth=-10.0), f"backend={backend}")
    signals = shown(loop, (0.3, 1.4))
    force = signals["truth.contact_force"].reshape(2, 4, -1).sum(axis=2)[1]
    assert force[[0, 2]].sum() > 0.95 * force.sum()
    lowest = signals["truth.foot_height"][1].reshape(4, 3).min(axis=1)
    np.testing.assert_allclose(lowest[[0, 2]], 0.0, atol=1e-4)
    assert lowest.min() > -1e-4
    rise = np.diff(signals["truth.body_position"][:, 2])[0]
    assert rise == pytest.approx(5e-3, abs=1.5e-3)


def test_legs_of_a_centre_keep_their_lengths_when_the_panel_gives():
    loop = loop_of("machining_centre", sinking(2, depth=2.0))
    signals = shown(loop, (0.3, 1.2))
    geometry = loop.scenario.machine.geometry
    feet = signals["truth.feet"].reshape(2, -1, 6)
    way = np.diff(feet, axis=0)[0]
    np.testing.assert_allclose(way[:, 2], (0.0, -2e-3, 0.0)[: len(way)], atol=3e-5)
    pose = signals["truth.pose"]
    assert pose[1, 2] < pose[0, 2] - 2e-4
    lengths = [np.ravel(leg_lengths(geometry, *each)) for each in zip(pose, feet, strict=True)]
    np.testing.assert_allclose(*lengths, atol=2e-5)


def test_a_centre_clamps_a_foot_again_where_the_panel_is_then():
    machine = find_machine("machining_centre")
    settings = ("plan.wait=0.5", f"disturbances={sinking(1, 2, 3, depth=1.0)}")
    scenario = load_scenario(machine.scenario, overrides=settings[-1:])
    loop = ClosedLoop(machine, scenario)
    simulator = loop.simulator()
    simulator.AdvanceTo(6.0)
    context = loop.station.GetMyContextFromRoot(simulator.get_context())
    gap = loop.station.GetOutputPort("truth.clamp_gap").Eval(context)
    closed = loop.station.GetOutputPort("clamps.closed").Eval(context)
    assert gap[closed > 0.5].max() < 1e-4


@pytest.mark.parametrize("foot", [1, 2, 3])
def test_a_mechanism_leans_as_the_plane_through_its_feet_does(foot):
    machine = find_machine("any_mechanism")
    settings = (
        f"machine.file={HEXAPOD}",
        "machine.base=ground",
        f"machine.feet_mm={FEET.tolist()}",
        "machine.home=[0.02, 0.02, 0.02, 0.02, 0.02, 0.02]",
        "track.waypoints=[{time: 3}]",
        f"disturbances={sinking(foot)}",
    )
    loop = ClosedLoop(machine, load_scenario(machine.scenario, overrides=settings))
    before, after = shown(loop, (0.3, 1.5))["truth.base"]
    heights = np.zeros(3)
    heights[foot - 1] = -5.0
    # z = a + b x + c y through the feet: pitch is -b, roll is c.
    plane = np.column_stack((np.ones(3), FEET[:, :2]))
    a, b, c = np.linalg.solve(plane, heights)
    change = after - before
    assert change[3] == pytest.approx(c, abs=2e-5)
    assert change[4] == pytest.approx(-b, abs=2e-5)
    assert change[2] == pytest.approx(1e-3 * a, abs=2e-5)


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        (
            "walking_chair",
            (sinking(5),),
            r"disturbances\.0\.foot = 5: the machine has feet 1 to 4",
        ),
        ("machining_centre", (sinking(4),), r"foot = 4: the machine has feet 1 to 3"),
        (
            "walking_chair",
            (sinking(1), "backend=kinematic"),
            "must be empty with the backend 'kinematic': they act with multibody or mujoco",
        ),
        ("terrain_simulator", (sinking(1),), r"!Subsidence does not act on this machine"),
    ],
)
def test_ground_that_cannot_give_is_refused(name, settings, message):
    with pytest.raises(ScenarioError, match=message):
        loop_of(name, *settings)


def test_a_mechanism_that_is_welded_has_no_ground():
    machine = find_machine("any_mechanism")
    settings = (f"disturbances={sinking(1)}",)
    with pytest.raises(ScenarioError, match="the machine stands on no feet of its own"):
        ClosedLoop(machine, load_scenario(machine.scenario, overrides=settings))
