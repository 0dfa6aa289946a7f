import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.walking_chair.gait import TrotGait, Walk, there_and_back
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.planner import GaitPlanner

PERIOD = 0.01
GEOMETRY = ChairGeometry()
QUICK = Walk((TrotGait(phase_duration=1.0, body_law="ramped"),))


def start(fix, walk=QUICK, hold=0.0, **settings):
    planner = GaitPlanner(walk, period=PERIOD, **settings)
    simulator = Simulator(planner)
    context = simulator.get_mutable_context()
    fix(planner, context, hold=(hold,))
    return planner, simulator, context


def at(simulator, time):
    """Just after the sample at a time."""
    simulator.AdvanceTo(time + 0.5 * PERIOD)


@pytest.mark.parametrize("walk", [QUICK, there_and_back(QUICK.gaits[0])])
@pytest.mark.parametrize("time", [0.0, 0.37, 1.5, 2.25, 4.9, 6.0])
def test_outputs_are_the_walk_one_period_ahead(fix, read, walk, time):
    planner, simulator, context = start(fix, walk)
    at(simulator, time)
    shown = read(planner, context)
    clock = shown["gait_time"][0]
    assert clock == pytest.approx(min(time + PERIOD, walk.duration), abs=1e-9)
    motion = walk.motion(GEOMETRY, clock + PERIOD)
    body = np.concatenate((motion.body.position, motion.body.velocity, motion.body.acceleration))
    np.testing.assert_allclose(shown["body_motion"], body, rtol=0, atol=1e-10)
    feet = np.concatenate([part.ravel() for part in motion.feet])
    np.testing.assert_allclose(shown["foot_motion"], feet, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(shown["references"], motion.references)


def test_feet_stand_as_planned(fix):
    planner, simulator, context = start(fix)
    seen = {}
    for time in (0.5, 1.5, 2.5, 3.5, 4.5, 6.0):
        at(simulator, time)
        seen[time] = planner.GetOutputPort("support").Eval(context).tolist()
    everyone = [1.0] * 4
    assert seen == {
        0.5: everyone,
        1.5: [0.0, 1.0, 0.0, 1.0],
        2.5: everyone,
        3.5: [1.0, 0.0, 1.0, 0.0],
        4.5: everyone,
        6.0: everyone,
    }


def test_the_gait_is_over_at_its_end_and_the_chair_rests(fix, read):
    planner, simulator, context = start(fix)
    at(simulator, QUICK.duration - 0.05)
    assert planner.GetOutputPort("done").Eval(context)[0] == 0.0
    at(simulator, QUICK.duration + 1.0)
    shown = read(planner, context)
    assert shown["done"][0] == 1.0
    assert not shown["body_motion"][3:].any()
    assert shown["gait_time"][0] == QUICK.duration


def test_the_gait_begins_when_it_should(fix):
    planner, simulator, context = start(fix, begin=0.5)
    at(simulator, 0.45)
    assert planner.GetOutputPort("gait_time").Eval(context)[0] == 0.0
    at(simulator, 0.7)
    time = planner.GetOutputPort("gait_time").Eval(context)[0]
    assert time == pytest.approx(0.7 - 0.5 + PERIOD, abs=1e-9)


@pytest.mark.parametrize("since", [0.0, 0.4, 0.95, 2.3, 2.99])
def test_a_hold_stops_the_gait_where_all_feet_stand(fix, since):
    planner, simulator, context = start(fix)
    if since:
        at(simulator, since)
    fix(planner, context, hold=(1.0,))
    simulator.AdvanceTo(10.0)
    time = planner.GetOutputPort("gait_time").Eval(context)[0]
    phase = int(since + PERIOD)
    assert since <= time <= phase + 1.0 + 1e-9
    # At the very end of the phase the feet that are about to swing are still on the ground.
    assert QUICK.motion(GEOMETRY, time - 1e-9, "left").support.all()


@pytest.mark.parametrize("since", [1.2, 3.9])
def test_a_step_that_has_begun_is_completed(fix, since):
    planner, simulator, context = start(fix)
    at(simulator, since)
    fix(planner, context, hold=(1.0,))
    simulator.AdvanceTo(10.0)
    time = planner.GetOutputPort("gait_time").Eval(context)[0]
    landed = np.ceil(since)
    assert landed < time <= landed + 1.0
    assert planner.GetOutputPort("support").Eval(context).all() or time == landed + 1.0


def test_the_clock_slows_down_smoothly_and_runs_again_after_a_hold(fix):
    planner, simulator, context = start(fix, Walk((TrotGait(body_law="ramped"),)), pause=0.5)
    at(simulator, 1.0)
    fix(planner, context, hold=(1.0,))
    times = []
    for k in range(400):
        if k == 200:
            fix(planner, context, hold=(0.0,))
        at(simulator, 1.01 + k * PERIOD)
        times.append(planner.GetOutputPort("gait_time").Eval(context)[0])
    pace = np.diff(times) / PERIOD
    assert np.abs(np.diff(pace)).max() <= PERIOD / 0.5 + 1e-6
    assert pace.min() == pytest.approx(0.0, abs=1e-9)
    assert pace[-1] == pytest.approx(1.0, abs=1e-6)
    # Half of the time that it takes to stop is lost, and to run again, besides that of the rest.
    assert times[-1] - times[0] == pytest.approx(3.99 - 2.0 - 0.5 * 0.5 + 0.25, abs=0.03)


def test_velocities_follow_the_pace_of_the_clock(fix, read):
    planner, _, context = start(fix)
    context.SetDiscreteState(0, np.array((0.5, 0.4)))
    shown = read(planner, context)
    motion = QUICK.motion(GEOMETRY, 0.5 + 0.4 * PERIOD)
    np.testing.assert_allclose(shown["body_motion"][:3], motion.body.position, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        shown["body_motion"][3:6], 0.4 * np.asarray(motion.body.velocity), rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(
        shown["body_motion"][6:], 0.16 * np.asarray(motion.body.acceleration), rtol=0, atol=1e-12
    )


def test_an_unconnected_hold_never_holds():
    planner = GaitPlanner(QUICK)
    simulator = Simulator(planner)
    simulator.AdvanceTo(2.0)
    time = planner.GetOutputPort("gait_time").Eval(simulator.get_context())[0]
    assert time == pytest.approx(2.0, abs=0.011)


def test_a_long_walk_needs_no_more_memory_than_a_short_one(fix, read):
    # Nodes are computed a few seconds at a time, wherever the clock is.
    walk = Walk((TrotGait(cycles=1000, body_law="ramped"),))
    planner, _, context = start(fix, walk)
    context.SetDiscreteState(0, np.array((9000.0, 1.0)))
    motion = walk.motion(GEOMETRY, 9000.0 + PERIOD)
    np.testing.assert_allclose(
        read(planner, context)["body_motion"][:3], motion.body.position, rtol=0, atol=1e-9
    )
