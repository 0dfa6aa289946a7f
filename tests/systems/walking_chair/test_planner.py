"""Planners of references, a period ahead."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from parapod.systems.walking_chair.gait import TrotGait, Walk, there_and_back
from parapod.systems.walking_chair.geometry import ChairGeometry, LegGeometry
from parapod.systems.walking_chair.leg import leg_forward, leg_inverse
from parapod.systems.walking_chair.planner import CircleReference, GaitPlanner
from parapod.systems.walking_chair.trajectories import FootCircle

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


def test_a_long_walk_needs_no_more_memory_than_a_short_one(fix, read):
    # Nodes are computed a few seconds at a time, wherever the clock is.
    walk = Walk((TrotGait(cycles=1000, body_law="ramped"),))
    planner, _, context = start(fix, walk)
    context.SetDiscreteState(0, np.array((9000.0, 1.0)))
    motion = walk.motion(GEOMETRY, 9000.0 + PERIOD)
    np.testing.assert_allclose(
        read(planner, context)["body_motion"][:3], motion.body.position, rtol=0, atol=1e-9
    )


LEG = LegGeometry()


def lengths_at(circle, time):
    return leg_inverse(LEG, circle.motion(time).position)


@pytest.mark.parametrize("period", [0.01, 0.02])
def test_a_sample_is_where_the_foot_should_be_a_period_later(period):
    circle = FootCircle()
    builder = DiagramBuilder()
    reference = builder.AddSystem(CircleReference(circle, period=period))
    # Samples as a controller does, at the instants of the updates and before them.
    log = LogVectorOutput(reference.get_output_port(), builder, period)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.5)
    found = log.FindLog(simulator.get_context())
    assert len(found.sample_times()) > 20
    for time, node in zip(found.sample_times(), found.data().T, strict=True):
        np.testing.assert_allclose(node, lengths_at(circle, time + period), rtol=1e-12)


def test_nodes_rest_before_the_first_one_and_after_the_last_lap():
    circle = FootCircle(period=0.2, laps=1)
    reference = CircleReference(circle)
    simulator = Simulator(reference)
    simulator.AdvanceTo(0.5)
    node = reference.GetOutputPort("position_node").Eval(simulator.get_context())
    np.testing.assert_allclose(node, lengths_at(circle, 0.0), rtol=1e-13)


def test_nodes_put_the_foot_on_the_circle():
    simulator = Simulator(reference := CircleReference())
    for k in range(1, 50):
        simulator.AdvanceTo(0.1 * k - 0.003)
        node = reference.GetOutputPort("position_node").Eval(simulator.get_context())
        x, y, z = leg_forward(LEG, node).point
        assert np.hypot(x, y - 0.1) == pytest.approx(0.1, abs=1e-12)
        assert z == pytest.approx(-0.6754, abs=1e-12)


def test_a_circle_out_of_reach_gives_no_lengths():
    reference = CircleReference(FootCircle(z=0.5))
    node = reference.GetOutputPort("position_node").Eval(reference.CreateDefaultContext())
    assert np.isnan(node).all()


def test_a_circle_has_a_node_every_hundredth_of_a_second_if_nobody_says_another_period():
    reference = CircleReference()
    timing = reference.GetUniquePeriodicDiscreteUpdateAttribute()
    assert (timing.period_sec(), timing.offset_sec()) == (0.01, 0.0)
    node = reference.GetOutputPort("position_node").Eval(reference.CreateDefaultContext())
    wanted = lengths_at(FootCircle(), 0.01)
    np.testing.assert_array_equal(node, wanted)


@pytest.mark.parametrize("time", [0.5, 1.37, 2.5])
def test_halted_it_stops_at_once_anywhere_and_goes_on_from_there(fix, read, time):
    planner, simulator, context = start(fix)
    at(simulator, time)
    fix(planner, context, halt=(1.0,))
    begun = read(planner, context)["gait_time"][0]
    at(simulator, time + 0.11)
    halted = read(planner, context)
    # On a ramp of .1 s: half of that is still gone.
    assert halted["gait_time"][0] - begun == pytest.approx(0.055, abs=0.02)
    at(simulator, time + 3.0)
    stands = read(planner, context)
    assert stands["gait_time"] == halted["gait_time"]
    assert not stands["body_motion"][3:].any()
    assert not stands["foot_motion"][12:].any()
    fix(planner, context, halt=(0.0,))
    at(simulator, time + 3.0 + 1.0)
    # And half a pause to begin again.
    assert read(planner, context)["gait_time"][0] - halted["gait_time"][0] == pytest.approx(
        0.75, abs=0.03
    )
