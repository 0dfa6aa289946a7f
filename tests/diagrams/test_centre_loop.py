"""Station and controller of the machining centres together: small jobs from begin to end."""

import math
from functools import cache

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.machining_centre.design import CentreDesign, LegScenario
from parapod.diagrams.machining_centre.machine import MACHINING_CENTRE
from parapod.diagrams.machining_centre.plants import Beginning, make_drives
from parapod.diagrams.machining_centre.scenario import (
    CentreControlScenario,
    CentreScenario,
    HolesScenario,
    MotionScenario,
    PanelScenario,
    ProcessScenario,
    WalkScenario,
)
from parapod.diagrams.station import Station
from parapod.systems.core.errors import ScenarioError
from parapod.systems.machining_centre.platform_mode import leg_lengths
from parapod.systems.machining_centre.sequence import Phase
from parapod.systems.machining_centre.statics import CentreStatics

LIMBS = pytest.mark.parametrize("limbs", [3, 4], ids=["tripod", "quadruped"])


def scenario_of(limbs=3, backend="kinematic", holes=1, period=0.02, legs=None, **changes):
    """A job of some seconds."""
    usual = {
        "begin": 0.1,
        "holes": HolesScenario(count=holes, depth_mm=2.0),
        "walk": WalkScenario(advance_mm=15.0, steps=1, lift_mm=10.0),
        "motion": MotionScenario(150.0, 60.0, 10.0, 150.0, 1500.0),
        "control": CentreControlScenario(period, settling=0.05),
    }
    legs = LegScenario(max_velocity_mm_s=400.0) if legs is None else legs
    machine = CentreDesign(limbs=limbs, legs=legs)
    return CentreScenario(backend=backend, machine=machine, **(usual | changes))


def run_to(loop, is_over, rest=0.1, longest=30.0, monitored=True):
    """Simulates until the signals say so, and a little longer; the recording."""
    simulator = Simulator(loop)
    context = simulator.get_mutable_context()
    loop.reset(context)
    if monitored and loop.monitor is not None:
        simulator.set_monitor(loop.monitor)
    simulator.Initialize()
    signals = loop.readings(context, ("done", "operation", "phase"))
    while not is_over({name: read()[0] for name, read in signals.items()}, context.get_time()):
        assert context.get_time() < longest
        simulator.AdvanceTo(context.get_time() + 0.1)
    simulator.AdvanceTo(context.get_time() + rest)
    return loop.recording(context)


def test_drives_have_the_scenarios_numbers_in_si_units():
    legs = LegScenario(max_velocity_mm_s=90.0, encoder_resolution_mm=0.02, time_constant_ms=15.0)
    scenario = CentreScenario(machine=CentreDesign(legs=legs))
    drives = make_drives(scenario, Beginning.from_scenario(scenario), 0.005).params
    assert (drives.max_velocity, drives.resolution) == pytest.approx((0.09, 2e-5))
    assert drives.time_constant == pytest.approx(0.015)


@pytest.mark.parametrize(("radius_mm", "radius"), [(0.0, math.inf), (2500.0, 2.5)])
def test_a_panel_of_no_radius_is_plane(radius_mm, radius):
    assert CentreScenario(panel=PanelScenario(radius_mm)).plan.job.panel.radius == radius


def is_done(signals, time):
    return signals["done"] > 0.5


@cache
def whole_job(limbs, backend="kinematic", **changes):
    scenario = scenario_of(limbs, backend, **changes)
    return scenario, run_to(ClosedLoop(MACHINING_CENTRE, scenario), is_done)


def phases_of(run):
    values = run["phase"][:, 0].astype(int)
    changed = np.flatnonzero(np.diff(values, prepend=-1))
    return [Phase(value) for value in values[changed]]


def feet_of(scenario, run):
    return run["truth.feet"].reshape(len(run.time), scenario.limbs, 6)


@LIMBS
def test_a_small_job_is_done_with_all_feet_where_they_were_to_go(limbs):
    scenario, run = whole_job(limbs)
    assert phases_of(run)[-1] is Phase.DONE
    assert run["operation"][-1, 0] == limbs + 2
    assert not run["fault"].any()
    plan, feet = scenario.plan, feet_of(scenario, run)
    place = plan.job.panel.place
    gone = place(feet[-1, :, :3]) - place(feet[0, :, :3])
    assert np.allclose(gone[:, 0], 0.015, atol=5e-4)
    assert np.allclose(gone[:, 1:], 0.0, atol=5e-4)
    assert run["clamps.closed"][-1].all()
    assert not run["locks.closed"][-1].any()
    assert run["truth.tip_height"].min() == pytest.approx(-2e-3, abs=2e-4)
    assert run["tool.force"].max() > 50.0


@LIMBS
def test_never_are_two_feet_loose_and_none_without_its_locks(limbs):
    _, run = whole_job(limbs)
    closed = run["clamps.closed"] > 0.5
    assert set((~closed).sum(axis=1)) == {0, 1}
    locks = run["locks.closed"].reshape(len(run.time), limbs, 4) > 0.5
    for k, limb in np.argwhere(~closed):
        assert locks[k, limb].all()
        assert run["loose_limb"][k, 0] in (limb + 1, 0.0)


@LIMBS
def test_a_stop_in_a_swing_puts_the_foot_down_and_ends(limbs):
    _, run = whole_job(limbs)
    swinging = run.time[run["phase"][:, 0] == Phase.SWING]
    stopped = scenario_of(limbs, stop_at=float(swinging[5]))
    short = run_to(ClosedLoop(MACHINING_CENTRE, stopped), is_done)
    assert phases_of(short)[-1] is Phase.STOPPED
    assert short["operation"][-1, 0] == 2
    assert short["clamps.closed"][-1].all()
    assert not short["locks.closed"][-1].any()
    before = short.time < swinging[5]
    assert np.allclose(short["truth.pose"][before], run["truth.pose"][: before.sum()])
    panel = stopped.plan.job.panel
    height = panel.place(feet_of(stopped, short)[-1, :, :3])[:, 2]
    assert np.allclose(height, panel.foot_height, atol=1e-4)


@pytest.mark.parametrize(
    ("limbs", "backend"), [(3, "kinematic"), (4, "kinematic"), (3, "multibody")]
)
def test_errors_of_the_encoders_show_in_the_truth_and_nowhere_else(limbs, backend):
    large = LegScenario(max_velocity_mm_s=400.0, length_error_mm=0.2)
    off = {}
    for seed in (0, 1):
        scenario = scenario_of(limbs, backend, legs=large, seed=seed)
        loop = ClosedLoop(MACHINING_CENTRE, scenario)
        run = run_to(loop, lambda signals, time: time > 0.3)
        errors = scenario.length_errors
        assert 5e-5 < np.abs(errors).max() <= 2e-4
        pose, feet = run["truth.pose"][-1], feet_of(scenario, run)[-1]
        true = leg_lengths(scenario.machine.geometry, pose, feet)
        told = run["legs.position"][-1]
        if limbs == 3:  # eight legs contradict each other
            # Legs of rigid bodies yield to the weight.
            yields = 5e-6 if backend == "multibody" else 0.0
            assert np.allclose(true - told, errors, atol=3e-6 + yields)
        off[seed] = run["pose_estimated"][-1] - run["truth.pose"][-1]
        assert np.abs(off[seed]).max() > 3e-5
        assert not run["fault"].any()
    assert not np.allclose(off[0], off[1], atol=1e-5)


def test_perfect_encoders_tell_the_truth():
    perfect = LegScenario(max_velocity_mm_s=400.0, length_error_mm=0.0, encoder_resolution_mm=0.0)
    scenario = scenario_of(legs=perfect, walk=WalkScenario())
    scenario.control.knows_stiffness = False
    run = run_to(ClosedLoop(MACHINING_CENTRE, scenario), is_done, rest=0.3)
    assert phases_of(run)[-1] is Phase.DONE
    assert np.allclose(run["pose_estimated"][-1], run["truth.pose"][-1], atol=1e-9)
    assert np.allclose(run["pose_estimated"][-1], scenario.plan.end.pose, atol=1e-9)


def test_another_scenario_begins_where_it_does_in_the_same_loop():
    scenario = scenario_of()
    loop = ClosedLoop(MACHINING_CENTRE, scenario, log=("truth.pose", "legs.position"))
    context = loop.CreateDefaultContext()
    readings = loop.readings(context, ("truth.pose", "legs.position"))
    before = {name: read() for name, read in readings.items()}
    other = scenario_of(seed=5)
    loop.reset(context, other)
    expected = leg_lengths(other.machine.geometry, *other.plan.beginning) - other.length_errors
    assert np.allclose(readings["legs.position"](), expected, atol=1e-6)
    assert not np.allclose(before["legs.position"], expected, atol=1e-6)
    loop.reset(context)
    assert np.array_equal(readings["legs.position"](), before["legs.position"])


# Rigid bodies


def soft(**changes):
    """A walk on legs that yield by tenths of millimetres."""
    legs = LegScenario(max_velocity_mm_s=400.0, length_error_mm=0.0, stiffness_N_um=1.0)
    scenario = scenario_of(3, "multibody", holes=0, period=0.01, legs=legs)
    for name, value in changes.items():
        setattr(scenario.control, name, value)
    return scenario


def foot_error(scenario, run):
    """Distance of the first foot that swings from its foothold, once it stands."""
    swing = scenario.plan.job.operations[0]
    foot = feet_of(scenario, run)[-1, swing.lock_set.limb - 1]
    return np.linalg.norm(foot[:3] - swing.foothold[:3])


def test_a_walk_of_rigid_bodies_is_done_with_its_locks_kept():
    scenario, run = whole_job(3, "multibody", holes=0, period=0.01)
    assert phases_of(run)[-1] is Phase.DONE
    plan, feet = scenario.plan, feet_of(scenario, run)
    assert np.linalg.norm(feet[-1, :, :3] - plan.end.feet[:, :3], axis=1).max() < 1e-3
    locked = run["locks.closed"] > 0.5
    assert locked.any()
    joints, both = run["truth.joints"], locked[1:] & locked[:-1]
    assert np.abs(np.diff(joints, axis=0)[both]).max() < 1e-9
    assert np.abs(np.diff(joints, axis=0)).max() > 1e-3
    assert run["truth.loop_error"].max() < 1e-4
    closed = run["clamps.closed"] > 0.5
    assert run["truth.clamp_gap"][closed].max() < 1e-3
    assert run["truth.clamp_gap"].max() > 5e-3


def test_legs_of_rigid_bodies_carry_the_weight_that_statics_say():
    scenario, run = whole_job(3, "multibody", holes=0, period=0.01)
    rest = (run["phase"][:, 0] == Phase.WAITING) & (run.time > 0.08)
    pose, feet = scenario.plan.beginning
    height = pose[2] - np.repeat(feet[:, 2], 2)
    up = height / leg_lengths(scenario.machine.geometry, pose, feet)
    force = run["truth.leg_force"][rest]
    assert (force > 0.0).all()
    carried = 9.81 * (10.2 + 3 * 5.2 / 2)
    assert (force * up).sum(axis=1) == pytest.approx(carried, rel=0.1)
    assert np.allclose(run["legs.current"][rest], force / 250.0, atol=0.02)


def test_legs_of_rigid_bodies_feel_the_drill_as_statics_say(stand):
    process = ProcessScenario(torque_Nm=20.0)
    slow = MotionScenario(150.0, 60.0, 5.0, 150.0, 1500.0)
    scenario = scenario_of(
        *(3, "multibody"), period=0.01, walk=WalkScenario(), process=process, motion=slow
    )
    scenario.holes.depth_mm = 4.0
    run = run_to(ClosedLoop(MACHINING_CENTRE, scenario), is_done)
    loaded = np.flatnonzero(run["tool.force"][:, 0] > 120.0)
    assert len(loaded) > 5
    assert run["truth.tip_height"].min() == pytest.approx(-4e-3, abs=3e-4)
    statics = stand(CentreStatics(scenario.machine.geometry), clamps_closed=np.ones(3))
    for k in loaded:
        statics.set(pose=run["truth.pose"][k], feet=run["truth.feet"][k])
        felt = {
            name: statics.set(tool_force=tool)["leg_force"]
            for name, tool in (("free", np.zeros(2)), ("loaded", run["tool.force"][k]))
        }
        by_drill = felt["loaded"] - felt["free"]
        off = run["truth.leg_force"][k] - felt["loaded"]
        assert np.abs(off).max() < 0.25 * np.abs(by_drill).max()


def test_a_foot_comes_nearer_to_its_foothold_where_legs_are_known_to_yield():
    errors = {}
    for knows in (True, False):
        scenario = soft(knows_stiffness=knows)
        loop = ClosedLoop(MACHINING_CENTRE, scenario)
        run = run_to(loop, lambda signals, time: signals["operation"] >= 1)
        errors[knows] = foot_error(scenario, run)
    assert errors[True] < 0.6 * errors[False]
    assert errors[False] > 5e-5


def test_bodies_obey_only_where_somebody_looks_between_the_steps():
    assert ClosedLoop(MACHINING_CENTRE, scenario_of()).monitor is None
    scenario = scenario_of(3, "multibody", holes=0, period=0.01)
    for monitored in (False, True):
        loop = ClosedLoop(MACHINING_CENTRE, scenario)
        assert loop.monitor is not None
        run = run_to(loop, lambda signals, time: time > 0.95, monitored=monitored)
        assert Phase.LOCK in phases_of(run)
        assert run["locks.closed"].any() == monitored


# Other plants and shapes


@LIMBS
@pytest.mark.parametrize("backend", ["multibody", "kinematic", "mock"])
def test_ports_have_the_sizes_of_the_limbs(limbs, backend):
    scenario = scenario_of(limbs, backend, holes=0, walk=WalkScenario())
    station = Station(MACHINING_CENTRE, scenario)
    machine = MACHINING_CENTRE.for_scenario(scenario)
    assert machine.variant is None
    sizes = {"legs.position": 2, "locks.closed": 4, "clamps.closed": 1}
    for name, each in sizes.items():
        assert machine.table[name].size == limbs * each
        assert station.GetOutputPort(name).size() == limbs * each
    for port in machine.inputs:
        assert station.GetInputPort(port.name).size() == port.size
    assert ("legs" in machine.real.self_tests) == (limbs == 3)
    assert station.HasOutputPort("truth.feet") == (backend != "mock")


def test_names_and_units_are_the_same_for_all_limbs():
    tables = [MACHINING_CENTRE.for_scenario(scenario_of(limbs)).table for limbs in (3, 4)]
    named = [[(name, port.unit, port.idle) for name, port in t.items()] for t in tables]
    assert named[0] == named[1]
    default = {port.name: port.size for port in MACHINING_CENTRE.ports}
    assert default == {name: tables[0][name].size for name in default}


@LIMBS
def test_a_mock_goes_through_a_job_of_holes(limbs):
    scenario = scenario_of(limbs, "mock", walk=WalkScenario())
    run = run_to(ClosedLoop(MACHINING_CENTRE, scenario), is_done)
    ended = [Phase.WAITING, Phase.SETTLED, Phase.MACHINING, Phase.SETTLED, Phase.DONE]
    assert [phase for phase in phases_of(run) if phase is not Phase.SETTLED] == [
        phase for phase in ended if phase is not Phase.SETTLED
    ]
    assert run["operation"][-1, 0] == 1
    moved = run["legs.position"]
    assert np.ptp(moved, axis=0).max() > 0.01
    assert np.abs(run["length_error"]).max() < 1e-9


def test_locks_of_a_walk_are_read_from_their_text():
    assert WalkScenario(locks="q3 of 1, q6 of 2").chosen(3) == ((1, 3), (2, 6))
    assert WalkScenario(locks="paper").chosen(3) == ((1, 1), (2, 1))
    assert WalkScenario(locks="paper").chosen(4) is None
    assert WalkScenario().chosen(3) is None
    for text in ("q4 of 1, q1 of 2", "q1 of 3, q1 of 2", "q1 of 1", "q1", "", "q1 of 1, q1 of 1"):
        with pytest.raises(ScenarioError, match=r"walk\.locks"):
            WalkScenario(locks=text).chosen(3)


def test_a_plan_is_made_once_and_follows_its_scenario():
    assert scenario_of().plan is scenario_of(seed=3).plan
    higher = WalkScenario(advance_mm=15.0, steps=1, lift_mm=12.0)
    for changes in ({"holes": 2}, {"limbs": 4}, {"walk": higher}):
        assert scenario_of(**changes).plan is not scenario_of().plan
    assert scenario_of(walk=higher).plan.job.lift == pytest.approx(0.012)


def test_the_same_row_is_drilled_once_more_where_the_feet_have_gone():
    plan = scenario_of().plan
    assert plan.shift == pytest.approx((0.015, 0.0))
    first, last = plan.job.operations[0], plan.job.operations[-1]
    gone = plan.job.panel.place(last.hole[:3]) - plan.job.panel.place(first.hole[:3])
    assert gone == pytest.approx((0.015, 0.0, 0.0), abs=1e-12)
