"""The bench in a person's hands: sliders move the plate, and the guard keeps it from limits."""

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from parapod.diagrams.terrain_simulator.design import BenchDesign
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.diagrams.terrain_simulator.view import BenchTwin
from parapod.sims.lab.panel import Readout
from parapod.sims.terrain_simulator.live import LiveBench
from parapod.sims.terrain_simulator.walk import BenchWalking, walking_loop
from parapod.systems.terrain_simulator.kinematics import singularity

WALKING = BenchWalking("bench-walk")


class Sliders:
    """Sliders that somebody has moved."""

    def __init__(self):
        self.values = {"x [mm]": 513.0, "z [mm]": 300.0, "phi [deg]": 0.0}

    def GetSliderNames(self):
        return list(self.values)

    def GetSliderValue(self, name):
        return self.values[name]


def test_the_plate_goes_where_the_sliders_are_and_the_leg_stays_on_it():
    sliders, scenario = Sliders(), TerrainBenchScenario()
    loop = WALKING.operated(scenario, sliders)
    simulator = Simulator(loop)
    simulator.set_monitor(loop.monitor)
    root = simulator.get_mutable_context()
    loop.reset(root)
    names = ("truth.pose", "truth.foot_force", "share")
    now = loop.readings(root, names)
    sliders.values |= {"x [mm]": 540.0, "z [mm]": 285.0, "phi [deg]": 10.0}
    simulator.AdvanceTo(1.3)
    wanted = (0.540, 0.285, np.radians(10.0))
    np.testing.assert_allclose(now["truth.pose"](), wanted, atol=2e-3)
    assert now["truth.foot_force"]()[1] == pytest.approx(294.3, rel=0.05)
    # Beyond what is possible it stops where plate and strut make the least angle.
    sliders.values["phi [deg]"] = 75.0
    simulator.AdvanceTo(2.8)
    held = float(singularity(scenario.machine.geometry, now["truth.pose"]()).sin_mu)
    assert held == pytest.approx(0.25, abs=3e-3)
    assert now["share"]()[0] < 0.01
    assert now["truth.foot_force"]()[1] == pytest.approx(294.3, rel=0.3)


def test_a_terrain_is_walked_at_the_speed_that_is_chosen():
    bench = LiveBench(WALKING, TerrainBenchScenario(), None)
    slow, usual = (bench.walk_of("stairs up", share).gait.speed_m_s for share in (50.0, 100.0))
    assert usual == pytest.approx(0.435)
    assert slow == pytest.approx(0.5 * usual)
    belt = TerrainBenchScenario(machine=BenchDesign(configuration="treadmill"))
    assert LiveBench(WALKING, belt, None).walk_of("level", 50.0).gait.speed_m_s == 0.75


def test_a_walk_that_cannot_be_is_told_until_another_one_is_asked_for(monkeypatch):
    sliders = Sliders()
    sliders.values["speed [%]"] = 200.0
    shown = Readout("slowed down to 3 %", remarks=("the cells are overloaded",))
    told = []

    def read_out(experiment, *of):
        told.append(of)
        return shown

    monkeypatch.setattr(BenchWalking, "read_out", read_out)
    bench = LiveBench(WALKING, TerrainBenchScenario(), sliders)
    bench._state = "stands"
    assert not bench._may_walk("stairs up")
    page = bench.read_out("loop", "context")
    assert told == [("loop", "context")]
    assert page.state == "stands, slowed down to 3 %"
    refusal, other = page.remarks
    assert "no walk over stairs up" in refusal
    assert "largest admissible speed is 0.4" in refusal
    assert other == "the cells are overloaded"
    sliders.values["speed [%]"] = 100.0
    assert bench._may_walk("stairs up")
    assert bench.read_out(None, None).remarks == (other,)


def test_the_page_tells_pose_hip_force_and_way():
    scenario = TerrainBenchScenario()
    loop = walking_loop(scenario, log=())
    simulator = Simulator(loop)
    simulator.set_monitor(loop.monitor)
    simulator.AdvanceTo(0.3)
    shown = WALKING.read_out(loop, simulator.get_context())
    rows = {row.label: row for row in shown.rows}
    x, z, phi = scenario.walk.at(0.3).pose[0]
    for label, value, unit in (("x", 1e3 * x, "mm"), ("z", 1e3 * z, "mm"), ("phi", phi, "deg")):
        assert rows[label].asked == pytest.approx(value, abs=0.1)
        assert rows[label].true == pytest.approx(value, abs=0.1)
        assert rows[label].unit == unit
    assert rows["hip"].measured == pytest.approx(1e3 * scenario.walk.hip[1], abs=1.0)
    assert rows["ground on the foot"].measured == pytest.approx(294.3, rel=0.01)
    assert rows["way of the body"].measured == 0.0
    assert not shown.state
    assert not shown.remarks


def test_the_drawing_of_the_real_bench_stays_while_nothing_is_known():
    meshcat = Meshcat()
    twin = BenchTwin(meshcat, TerrainBenchScenario())
    measured, led = np.array((0.513, 0.30, 0.1)), np.array((0.55, 0.28, 0.0))
    known = {
        "pose_estimated": measured,
        "pose_desired": led,
        "hip.position": np.array((0.88,)),
        "leg.position": np.array((0.6, -1.2)),
    }
    twin.show(known)

    def drawn(part):
        return twin._diagram.GetInputPort(part).Eval(twin._context)

    np.testing.assert_array_equal(drawn("measured_pose"), measured)
    np.testing.assert_array_equal(drawn("desired_pose"), led)
    assert drawn("measured_hip") == pytest.approx((TerrainBenchScenario().walk.hip[0], 0.88))
    assert all(map(meshcat.HasPath, ("measured", "desired")))
    for lost in ("pose_estimated", "hip.position", "leg.position"):
        twin.show(known | {"pose_desired": measured, lost: np.full(known[lost].shape, np.nan)})
        np.testing.assert_array_equal(drawn("desired_pose"), led)
