"""The bench of bodies with its leg: tracking, forces, belt, brake, the same leg in the world."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.drivers.cia402 import Epos2TorqueAxes
from parapod.diagrams.terrain_simulator.controller import make_controller
from parapod.diagrams.terrain_simulator.design import BenchDesign, CellsScenario
from parapod.diagrams.terrain_simulator.machine import TERRAIN_BENCH
from parapod.diagrams.terrain_simulator.plants import make_sliders
from parapod.diagrams.terrain_simulator.real import BenchGuard, BenchLimits
from parapod.diagrams.terrain_simulator.scenario import (
    BenchControlScenario,
    GaitScenario,
    HipScenario,
    LegScenario,
    PlaceScenario,
    TerrainBenchScenario,
)
from parapod.diagrams.terrain_simulator.terrains import Level, Recorded, Slope, Step
from parapod.diagrams.terrain_simulator.world import walking_in_the_world
from parapod.sims.terrain_simulator.walk import check_bench
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.physics import GRAVITY

QUIET = BenchDesign(cells=CellsScenario(noise_N=0.0))
GAIT = GaitScenario(speed_m_s=0.8, ramp=None, strides=1, run_up=0, clearance_mm=60.0)
STEP = TerrainBenchScenario(
    begin=0.15,
    end=0.05,
    shift=0.1,
    terrain=Step(rise_mm=60.0, at_m=0.2),
    gait=GAIT,
    machine=QUIET,
    place=PlaceScenario(540.0, 270.0),
)


def driven(**changes):
    """The quiet bench with other drives."""
    return replace(QUIET, sliders=replace(QUIET.sliders, **changes))


def noisy(deviation):
    return BenchDesign(cells=CellsScenario(noise_N=deviation))


def run(scenario, machine=TERRAIN_BENCH, duration=None):
    loop = ClosedLoop(machine, scenario)
    simulator = Simulator(loop)
    if loop.monitor is not None:
        simulator.set_monitor(loop.monitor)
    simulator.AdvanceTo(scenario.walk.duration + scenario.end if duration is None else duration)
    return loop.recording(simulator.get_context())


@pytest.fixture(scope="module")
def stepped():
    return run(STEP)


def test_plate_hip_and_force_follow_what_is_asked(stepped):
    asked = STEP.walk.at(stepped.time)
    error = np.abs(stepped["truth.pose"] - asked.pose[0])
    assert error[:, :2].max() < 1e-4
    assert np.degrees(error[:, 2].max()) < 0.01
    assert stepped["truth.loop_error"].max() < 2e-5
    height = stepped["hip.position"][:, 0] - STEP.walk.hip[1] - asked.bounce[0]
    assert np.abs(height).max() < 5e-3
    middle = asked.stance & (asked.force > 0.5 * STEP.walk.support.peak)
    force = stepped["truth.foot_force"][middle, 1]
    np.testing.assert_allclose(force, asked.force[middle], rtol=0.04)
    assert (stepped["share"][1:] == 1.0).all()


def test_the_forces_move_the_mass_as_newton_has_it(stepped):
    """Ground and drive by the weight, against the momentum of slide and leg together."""
    after = stepped.time > 0.1
    carried = stepped["truth.foot_force"][after, 1] + stepped["hip.force_command"][after, 0]
    rates = stepped["hip.velocity"][after, 0]
    lasted = np.ptp(stepped.time[after])
    needed = 30.0 * (GRAVITY + (rates[-1] - rates[0]) / lasted)
    assert carried.mean() == pytest.approx(needed, rel=1e-3)


def test_cells_and_currents_tell_the_force_of_the_foot(stepped):
    # The cells are read once a period, and shown in the next one.
    ground, shown = stepped["truth.foot_force"][60:-1], stepped["foot_load"][61:, :2]
    assert np.quantile(np.abs(shown + ground), 0.99) < 1.5
    # A current is ten milliseconds old at most.
    rest = (stepped.time > 0.1) & (stepped.time < STEP.begin)
    told = stepped["load_estimated"][rest, 1].mean()
    assert told == pytest.approx(-stepped["truth.foot_force"][rest, 1].mean(), rel=0.01)
    np.testing.assert_allclose(
        stepped["pose_estimated"][rest], stepped["truth.pose"][rest], atol=1e-4
    )
    # From the first sample on: the bench is drawn by it.
    begun = stepped["pose_estimated"][0]
    np.testing.assert_allclose(begun, stepped["truth.pose"][0], atol=1e-4)


def test_the_leg_feels_in_the_world_what_it_feels_on_the_bench(stepped):
    free = replace(STEP, hip=HipScenario(adds_inertia=False))
    world = run(free, walking_in_the_world())
    later = stepped.time > 0.1
    bench, ground = (each["truth.foot_force"][later] for each in (stepped, world))
    size = np.sqrt(np.mean(np.sum(ground**2, axis=1)))
    assert np.sqrt(np.mean(np.sum((bench - ground) ** 2, axis=1))) < 0.03 * size
    height = stepped["hip.position"] - world["hip.position"]
    assert np.abs(height).max() < 1e-3


def test_without_the_bodys_inertia_bench_and_world_differ(stepped):
    """The body speeds up its rise by some tenths of gravity: the slide's drive must add that."""
    lacking = run(replace(STEP, hip=HipScenario(adds_inertia=False)))
    change = np.abs(lacking["hip.position"] - stepped["hip.position"]).max()
    assert change > 2e-4


def test_the_belt_carries_the_foot_to_the_rear_at_its_speed():
    walking = TerrainBenchScenario(
        machine=replace(QUIET, configuration="treadmill"),
        begin=0.05,
        end=0.0,
        shift=0.1,
        gait=GAIT,
    )
    found = run(walking)
    asked = walking.walk.at(found.time)
    pressed = asked.stance & (asked.force > 0.5 * walking.walk.support.peak)
    # On the belt the foot neither slips nor is held: next to no force along it.
    along, upwards = found["truth.foot_force"][pressed].T
    assert np.abs(along / upwards).max() < 0.15
    steady = (found.time > walking.walk.steady[0]) & pressed
    np.testing.assert_allclose(found["belt.velocity"][steady], 0.8, rtol=0.02)
    assert np.abs(found["truth.pose"][:, 0] - walking.walk.path.x_c).max() < 1e-4


def test_a_braked_slide_is_held_though_nothing_carries_it():
    loop = ClosedLoop(TERRAIN_BENCH, STEP, log=("hip.position",))
    simulator = Simulator(loop)
    station = loop.station
    monitor = loop.monitor
    simulator.set_monitor(monitor)
    simulator.AdvanceTo(0.05)
    before = loop.recording(simulator.get_context())["hip.position"][-1]
    context = station.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    station.GetInputPort("hip.brake").FixValue(context, [1.0])
    station.GetInputPort("leg.torque_command").FixValue(context, [0.0, 0.0])
    simulator.AdvanceTo(0.25)
    after = loop.recording(simulator.get_context())["hip.position"][-1]
    assert after == pytest.approx(before, abs=1e-3)


def test_the_force_of_the_drive_is_limited_to_what_it_can_give():
    weak = replace(STEP, hip=HipScenario(max_force_N=50.0))
    assert np.abs(run(weak, duration=0.4)["hip.force_command"]).max() <= 50.0


def test_the_sliders_push_no_harder_than_they_can():
    assert np.abs(run(STEP, duration=0.2)["truth.slider_force"]).max() > 60.0
    weak = replace(STEP, machine=driven(max_force_N=50.0))
    assert np.abs(run(weak, duration=0.2)["truth.slider_force"]).max() <= 50.0 + 1e-9


def test_settings_reach_what_they_are_about():
    """Each changes the numbers of the run that it should change."""
    usual = run(replace(STEP, machine=noisy(5.0)), duration=0.3)
    for changed, signal in (
        (replace(STEP, machine=noisy(0.0)), "cells.force"),
        (replace(STEP, seed=1, machine=noisy(5.0)), "cells.force"),
        (replace(STEP, leg=replace(STEP.leg, friction=0.1)), None),
        (
            replace(STEP, leg=replace(STEP.leg, stance_stiffness_N_m=[4e3, 2e4])),
            "leg.torque_command",
        ),
        (replace(STEP, hip=replace(STEP.hip, stiffness_N_m=0.0)), "hip.force_command"),
        (replace(STEP, hip=replace(STEP.hip, mass_kg=25.0)), "truth.foot_force"),
        (
            replace(STEP, machine=driven(stiffness_N_um=5.0)),
            "truth.pose",
        ),
    ):
        if signal is not None:
            other = run(changed, duration=0.3)
            assert np.abs(other[signal] - usual[signal]).max() > 1e-6, signal


def test_terrains_are_taken_as_they_are_named(tmp_path):
    path = tmp_path / "ground.csv"
    path.write_text("distance,height\n0,0\n0.1,0.02\n0.2,0.05\n")
    ground = replace(STEP, terrain=Recorded(file=str(path))).walk.path.terrain
    assert ground.height(0.15) == pytest.approx(0.035)
    assert Slope(20.0).make().height(1.0) == pytest.approx(np.tan(np.radians(20.0)))
    assert Level().make().height(3.0) == 0.0
    with pytest.raises(ScenarioError, match="cannot be read"):
        _ = replace(STEP, terrain=Recorded(file="nowhere.csv")).walk


def test_a_leg_that_is_heavier_than_the_slide_with_it_is_refused():
    with pytest.raises(ScenarioError, match=r"hip.mass_kg = 4 must be more than the 4.6 kg"):
        ClosedLoop(TERRAIN_BENCH, replace(STEP, hip=HipScenario(mass_kg=4.0)))


def test_without_drives_of_a_leg_the_real_slide_stays_braked():
    fitted = replace(STEP, leg=LegScenario())
    assert fitted.drives_leg
    assert not replace(STEP, backend="hardware").drives_leg


GOOD = {
    "sliders.position": np.array((0.29, 0.68, 0.87)),
    "sliders.velocity": np.zeros(3),
    "sliders.position_command": np.array((0.29, 0.68, 0.87)),
    "sliders.current": np.zeros(3),
    "sliders.emergency_stop": np.zeros(1),
    "cells.force": np.array((150.0, 150.0, 0.0)),
    "pose_estimated": np.array((0.5, 0.28, 0.0)),
    "hip.position": np.array([0.88]),
    "status.age": np.zeros(5),
}


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("", {}),
        ("emergency_stop", {"sliders.emergency_stop": np.ones(1)}),
        ("encoder_jump", {"sliders.position": np.array((0.29, 0.68, 1.07))}),
        ("following_error", {"sliders.position_command": np.array((0.29, 0.75, 0.87))}),
        ("overload", {"sliders.current": np.array((0.0, -60.0, 0.0))}),
        ("cells_overloaded", {"cells.force": np.array((150.0, 4000.0, 0.0))}),
        ("singularity", {"pose_estimated": np.array((0.5, 0.28, 1.1))}),
        ("hip_low", {"hip.position": np.array([0.41])}),
        ("sliders_stale", {"status.age": np.array((0.2, 0.0, 0.0, 0.0, 0.0))}),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_the_guard_of_the_real_bench_names_what_is_wrong(name, changed):
    guard = BenchGuard(TerrainBenchScenario())
    trip, now = None, 0.0
    for number in range(400):
        now += 0.001
        values = {k: v.copy() for k, v in (GOOD | (changed if number > 50 else {})).items()}
        trip = trip or guard.check(now, values)
    assert (trip.name if trip else "") == name


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("velocity", [-1.0, 0.0, 1.0])
@pytest.mark.parametrize(("share", "name"), [(0.9, ""), (1.1, "following_error")])
def test_a_slider_may_be_behind_by_a_fixed_way_and_by_its_own_speed(share, name, velocity, side):
    """At rest the 5 mm alone count: 40 ms of delay are no way for a slider that is stuck."""
    limits = BenchLimits()
    behind = share * (limits.following + limits.delay * abs(velocity))
    values = GOOD | {
        "sliders.position_command": GOOD["sliders.position"] + (0.0, side * behind, 0.0),
        "sliders.velocity": np.array((0.0, velocity, 0.0)),
    }
    guard, trip = BenchGuard(TerrainBenchScenario(), limits), None
    for number in range(300):
        trip = trip or guard.check(0.001 * number, {k: v.copy() for k, v in values.items()})
    assert (trip.name if trip else "") == name
    assert not trip or (trip.sign, trip.axis) == (
        "is more than 5 mm off its way",
        ("sliders", 1),
    )


@pytest.mark.parametrize(("leg", "walks"), [(True, True), (True, False), (False, True)])
def test_a_leg_does_not_walk_on_a_plate_that_is_elsewhere(leg, walks):
    """Without a leg the plate may be led there; in a person's hands it follows them slowly."""
    hardware = STEP if leg else replace(STEP, backend="hardware")
    guard, trip = BenchGuard(hardware), None
    away = {"pose_asked": np.array((0.5, 0.29, 0.0)), "pose_desired": np.array((0.5, 0.28, 0.0))}
    for number in range(300):
        values = GOOD | away | ({"done": np.zeros(1)} if walks else {})
        trip = trip or guard.check(0.001 * number, {k: v.copy() for k, v in values.items()})
    assert (trip.name if trip else "") == ("plate_behind" if leg and walks else "")


def test_a_leg_that_nothing_drives_may_be_sampled_as_slowly_as_the_drives():
    slow = replace(STEP, control=BenchControlScenario(0.01))
    assert slow.leg_period == 0.01
    with pytest.raises(ScenarioError, match=r"leg.\w+_damping_Ns_m = .* control.period = 0.01 s"):
        slow.leg.under_test.check(slow.walk, slow.leg_period)
    leg = Epos2TorqueAxes(part="leg", node_ids=[1, 2], signs=[1, 1])
    drivers = [driver for driver in slow.hardware.drivers if driver.part != "leg"]
    fitted = replace(slow, hardware=replace(slow.hardware, drivers=[*drivers, leg]))
    assert replace(fitted, backend="hardware").leg_period == 0.01
    for backend in ("kinematic", "mock"):
        assert replace(fitted, backend=backend).leg_period == 0.0
    alone = replace(slow, backend="hardware", leg=LegScenario(kind="walking_chair"))
    assert alone.leg_period == 0.0
    make_controller(alone)  # whose period is too long for the loops of the chair's screws


def test_drives_are_no_faster_than_the_scenario_has_them():
    machine = driven(max_velocity_m_s=1.2, max_acceleration_m_s2=40.0)
    params = make_sliders(replace(STEP, machine=machine)).params
    assert params.max_velocity == 1.2
    # A little more, so that an acceleration that is met exactly passes.
    assert 40.0 < params.acceleration < 41.0


OWN = """
from parapod.diagrams.terrain_simulator.leg import make_leg_model
from parapod.systems.terrain_simulator.impedance import FootImpedance, ImpedanceParams
from pydrake.systems.primitives import PassThrough


def make(scenario):
    soft = ImpedanceParams(stance_stiffness=(1e3, 2e3))
    return FootImpedance(make_leg_model(scenario.leg.description), soft)


def make_none(scenario):
    return PassThrough(2)
"""


def test_a_controller_of_ones_own_comes_from_a_file(tmp_path):
    path = tmp_path / "my_leg.py"
    path.write_text(OWN)

    def with_controller(text):
        return replace(STEP, leg=replace(STEP.leg, controller=text))

    own = run(with_controller(f"{path}:make"), duration=0.1)
    usual = run(STEP, duration=0.1)
    assert np.abs(own["leg.torque_command"] - usual["leg.torque_command"]).max() > 1e-3
    soft = replace(STEP, leg=replace(STEP.leg, stance_stiffness_N_m=[1e3, 2e3]))
    np.testing.assert_array_equal(
        own["leg.torque_command"], run(soft, duration=0.1)["leg.torque_command"]
    )
    wild = replace(STEP.leg, stance_damping_Ns_m=[1e3, 1e3])
    check_bench(replace(STEP, leg=replace(wild, controller=f"{path}:make")))  # not its dampers
    with pytest.raises(ScenarioError, match=r"leg.stance_damping_Ns_m = 1000 N s/m is too much"):
        check_bench(replace(STEP, leg=wild))
    for text, words in (
        (f"{path}:make_none", "lacks the output torque_command; it has: y"),
        (f"{path}:missing", "there is no function 'missing'"),
        ("nowhere.py:make", "there is no such file"),
        ("no_such_package:make", "cannot be loaded: ModuleNotFoundError"),
    ):
        with pytest.raises(ScenarioError, match=words) as caught:
            ClosedLoop(TERRAIN_BENCH, with_controller(text))
        assert "\n" not in str(caught.value)
