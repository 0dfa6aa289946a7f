"""The tip's feedforward, its loop by the legs, and the list of points."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.arm.arm_tip import ArmTip
from parapod.systems.levelling_platform.carried_arm import BarredTip, CarriedArm, UnreachableTip
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.pointing import TipFeedforward, TipLoop, TipScript
from parapod.systems.levelling_platform.statics import KinematicPlatformParams

GEOMETRY = PlatformGeometry()
CARRIED = CarriedArm(GEOMETRY, KinematicPlatformParams(), margin=0.05)
POINT, LEVEL = (1.03, 0.02, 2.36), (0.0, 0.0, 0.478)


def fix(system, context, **values):
    for name, value in values.items():
        system.GetInputPort(name).FixValue(context, value)


def at(system, context, name):
    return system.GetOutputPort(name).Eval(context)


def feedforward(command=POINT, **settings):
    system = TipFeedforward(CARRIED, 0.478, **settings)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    fix(system, context, tip_command=command, ground=[0.0, 0.0], enable=[1.0])
    return system, simulator, context


def test_before_a_command_the_platform_is_level_and_the_arm_at_zero():
    system, simulator, context = feedforward([math.nan] * 3)
    simulator.AdvanceTo(0.05)
    np.testing.assert_array_equal(at(system, context, "posture_command"), LEVEL)
    np.testing.assert_array_equal(at(system, context, "arm_request"), [0.0, 0.0])
    assert np.isnan(at(system, context, "tip_goal")).all()


def test_a_command_is_answered_by_posture_and_joints():
    system, simulator, context = feedforward()
    simulator.AdvanceTo(0.02)
    posture, joints = at(system, context, "posture_command"), at(system, context, "arm_request")
    np.testing.assert_allclose(CARRIED.tip_position(posture, joints), POINT, atol=1e-9)
    np.testing.assert_array_equal(at(system, context, "tip_goal"), POINT)
    assert at(system, context, "tip_refused") == 0.0


def test_without_enable_nothing_is_answered():
    system, simulator, context = feedforward()
    fix(system, context, enable=[0.0])
    simulator.AdvanceTo(0.02)
    assert np.isnan(at(system, context, "tip_goal")).all()


def test_a_new_estimate_of_the_ground_is_answered_anew():
    system, simulator, context = feedforward()
    simulator.AdvanceTo(0.02)
    before = at(system, context, "posture_command")
    fix(system, context, ground=[0.03, 0.05])
    simulator.AdvanceTo(0.04)
    assert not np.allclose(at(system, context, "posture_command"), before, atol=1e-6)


def test_what_is_out_of_reach_ends_the_run_or_the_nearest_point_is_aimed_at():
    _, simulator, _ = feedforward((1.8, 0.2, 1.2))
    with pytest.raises(UnreachableTip, match="nearest"):
        simulator.AdvanceTo(0.02)
    system, simulator, context = feedforward((1.8, 0.2, 1.2), on_unreachable="clamp")
    simulator.AdvanceTo(0.02)
    goal = at(system, context, "tip_goal")
    posture, joints = at(system, context, "posture_command"), at(system, context, "arm_request")
    np.testing.assert_allclose(CARRIED.tip_position(posture, joints), goal, atol=1e-5)
    assert 0.01 < np.linalg.norm(goal - (1.8, 0.2, 1.2)) < 0.1
    assert at(system, context, "tip_refused") == 1.0


def test_what_stability_forbids_changes_nothing_or_ends_the_run():
    carried = CarriedArm(GEOMETRY, KinematicPlatformParams(), margin=0.6)
    for settings in ({}, {"on_unreachable": "clamp"}):
        system = TipFeedforward(carried, 0.478, **settings)
        simulator = Simulator(system)
        context = simulator.get_mutable_context()
        fix(system, context, tip_command=(1.36, 0.81, 1.89), ground=[0.0, 0.0], enable=[1.0])
        if not settings:
            with pytest.raises(BarredTip):
                simulator.AdvanceTo(0.02)
            continue
        simulator.AdvanceTo(0.02)
        np.testing.assert_array_equal(at(system, context, "arm_request"), [0.0, 0.0])
        assert at(system, context, "tip_refused") == 1.0


def test_on_unreachable_is_one_of_two():
    with pytest.raises(ValueError, match='"raise" or "clamp"'):
        TipFeedforward(CARRIED, 0.478, on_unreachable="ignore")


OTHER, THIRD = (1.2, 0.3, 2.2), (0.9, -0.4, 2.3)


def test_an_answer_comes_after_its_delay_and_is_the_same():
    at_once, simulator, first = feedforward()
    simulator.AdvanceTo(0.005)
    system, simulator, context = feedforward(answer_delay=0.1)
    simulator.AdvanceTo(0.095)
    np.testing.assert_array_equal(at(system, context, "posture_command"), LEVEL)
    assert at(system, context, "tip_answered") == 0.0
    simulator.AdvanceTo(0.105)
    for name in ("tip_goal", "posture_command", "arm_request", "tip_refused", "tip_answered"):
        np.testing.assert_array_equal(at(system, context, name), at(at_once, first, name))
    assert at(system, context, "tip_answered") == 1.0


def test_of_what_is_asked_for_meanwhile_the_newest_is_answered_next():
    system, simulator, context = feedforward(answer_delay=0.1)
    goals = []
    for tick in range(30):
        if tick in (3, 5):
            fix(system, context, tip_command=OTHER if tick == 3 else THIRD)
        simulator.AdvanceTo(0.01 * tick + 0.005)
        goals.append(tuple(at(system, context, "tip_goal")))
    assert np.isnan(goals[9]).all()
    assert goals[10:21] == [POINT] * 11
    assert goals[21:] == [THIRD] * 9


def test_a_context_put_back_to_a_question_has_the_same_answer():
    system, simulator, context = feedforward(answer_delay=0.05)
    simulator.AdvanceTo(0.03)
    back = context.Clone()
    simulator.AdvanceTo(0.06)
    posture = at(system, context, "posture_command")
    fix(system, context, tip_command=OTHER)
    simulator.AdvanceTo(0.2)
    again = Simulator(system, back)
    again.AdvanceTo(0.06)
    np.testing.assert_array_equal(at(system, back, "posture_command"), posture)


def test_without_enable_a_question_is_dropped():
    system, simulator, context = feedforward(answer_delay=0.05)
    simulator.AdvanceTo(0.02)
    fix(system, context, enable=[0.0])
    simulator.AdvanceTo(0.04)
    fix(system, context, enable=[1.0], tip_command=OTHER)
    simulator.AdvanceTo(0.085)
    assert np.isnan(at(system, context, "tip_goal")).all()
    simulator.AdvanceTo(0.095)
    np.testing.assert_array_equal(at(system, context, "tip_goal"), OTHER)


def test_a_refusal_comes_when_its_answer_is_due():
    _, simulator, _ = feedforward((1.8, 0.2, 1.2), answer_delay=0.05)
    simulator.AdvanceTo(0.045)
    with pytest.raises(UnreachableTip, match="nearest"):
        simulator.AdvanceTo(0.055)


def test_what_is_answered_in_the_background_is_the_same_and_the_outputs_stay_until_then():
    at_once, simulator, first = feedforward()
    simulator.AdvanceTo(0.005)
    system, simulator, context = feedforward(in_background=True)
    for tick in range(6000):
        simulator.AdvanceTo(0.01 * tick + 0.005)
        if at(system, context, "tip_answered"):
            break
        np.testing.assert_array_equal(at(system, context, "posture_command"), LEVEL)
        time.sleep(0.01)
    assert tick > 0
    for name in ("tip_goal", "posture_command", "arm_request", "tip_refused", "tip_answered"):
        np.testing.assert_array_equal(at(system, context, name), at(at_once, first, name))


def test_a_refusal_in_the_background_ends_the_run():
    system, simulator, _ = feedforward((1.8, 0.2, 1.2), in_background=True)
    while system._answer([1.8, 0.2, 1.2, *[0.0] * 6], [0.0] * 2) is None:
        time.sleep(0.01)
    with pytest.raises(UnreachableTip, match="nearest") as caught:
        simulator.AdvanceTo(0.01)
    assert np.linalg.norm(caught.value.nearest - (1.8, 0.2, 1.2)) < 0.1


def test_an_answer_that_is_there_early_waits_until_it_is_due():
    system, simulator, context = feedforward(answer_delay=0.1, in_background=True)
    while system._answer([*POINT, *[0.0] * 6], [0.0] * 2) is None:
        time.sleep(0.01)
    simulator.AdvanceTo(0.095)
    assert at(system, context, "tip_answered") == 0.0
    simulator.AdvanceTo(0.105)
    assert at(system, context, "tip_answered") == 1.0


def loop_at(offset, attitude_error=(0.0, 0.0), **settings):
    """The loop with a platform that does at once what is asked for, off by some angles."""
    reach = CARRIED.reach(POINT).solution
    system = TipLoop(CARRIED, **settings)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    still = [*reach.posture, 0.0, 0.0, 0.0]
    fix(
        system,
        context,
        posture_desired_state=still,
        posture_command=reach.posture,
        tip_goal=np.array(POINT) + offset,
        arm_request=reach.joints,
        arm_position=reach.joints,
        ground=[0.0, 0.0],
        enable=[1.0],
    )

    def settle(duration):
        end = context.get_time() + duration
        while context.get_time() < end - 1e-9:
            posture = at(system, context, "posture_corrected_state")[:3]
            legs = inverse_kinematics(GEOMETRY, posture, (0.0, 0.0))
            attitude = posture[:2] + attitude_error
            fix(system, context, extension_measured=legs, attitude=attitude)
            simulator.AdvanceTo(context.get_time() + 0.01)

    return system, context, settle


def test_the_legs_bring_the_tip_to_its_point():
    system, context, settle = loop_at([0.004, -0.003, 0.005])
    settle(0.05)
    first = np.linalg.norm(at(system, context, "tip_estimated") - POINT - [0.004, -0.003, 0.005])
    assert first > 4e-3
    assert at(system, context, "tip_arrived") == 0.0
    settle(3.0)
    missed = at(system, context, "tip_estimated") - POINT - [0.004, -0.003, 0.005]
    assert np.linalg.norm(missed) < 5e-5
    assert at(system, context, "tip_arrived") == 1.0


def test_the_tip_has_not_arrived_while_its_command_has_no_answer():
    system, context, settle = loop_at(np.zeros(3))
    settle(0.05)
    assert at(system, context, "tip_arrived") == 1.0
    fix(system, context, tip_answered=[0.0])
    settle(0.02)
    assert at(system, context, "tip_arrived") == 0.0
    settle(4.0)
    assert at(system, context, "tip_arrived") == 0.0
    fix(system, context, tip_answered=[1.0])
    settle(0.02)
    assert at(system, context, "tip_arrived") == 1.0


def test_a_platform_that_stands_askew_is_seen_by_its_inertial_sensor():
    system, context, settle = loop_at(np.zeros(3), attitude_error=np.radians([0.2, -0.1]))
    settle(3.5)
    np.testing.assert_allclose(at(system, context, "tip_estimated"), POINT, atol=5e-5)
    correction = at(system, context, "posture_corrected_state")[:2]
    reference = CARRIED.reach(POINT).solution.posture[:2]
    # What the sensor sees too much, the legs take away.
    np.testing.assert_allclose(correction - reference, -np.radians([0.2, -0.1]), atol=2e-4)


def test_a_point_that_the_legs_cannot_reach_counts_as_arrived_after_a_while():
    system, context, settle = loop_at([0.0, 0.0, 0.3])
    settle(2.0)
    assert at(system, context, "tip_arrived") == 0.0
    settle(1.5)
    assert at(system, context, "tip_arrived") == 1.0
    correction = at(system, context, "posture_corrected_state")[2] - 0.478
    assert abs(correction) < 0.1


def test_nothing_is_corrected_while_the_arm_moves():
    system, context, settle = loop_at([0.004, 0.0, 0.0])
    fix(system, context, arm_position=CARRIED.reach(POINT).solution.joints + 0.1)
    settle(0.5)
    reference = CARRIED.reach(POINT).solution.posture
    corrected = at(system, context, "posture_corrected_state")[:3]
    np.testing.assert_array_equal(corrected, reference)


def test_one_leg_on_ground_that_has_given_way_does_not_change_the_height():
    system, context, settle = loop_at(np.zeros(3))
    settle(0.1)
    legs = system.GetInputPort("extension_measured").Eval(context).copy()
    legs[1] += 2e-3
    fix(system, context, extension_measured=legs)
    np.testing.assert_allclose(at(system, context, "tip_estimated")[2], POINT[2], atol=2e-4)


def test_a_script_takes_no_arrival_that_was_told_before_its_command():
    system = TipScript([POINT, OTHER], hold=0.0, period=0.01)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    fix(system, context, ground_valid=[1.0], tip_arrived=[1.0])
    done = []
    for tick in range(6):
        simulator.AdvanceTo(0.01 * tick + 0.005)
        done.append(at(system, context, "points_done")[0])
    assert done == [0.0, 0.0, 1.0, 1.0, 2.0, 2.0]


def test_a_script_waits_for_arrival_and_holds():
    points = [(1.0, 0.0, 2.3), (0.5, 1.0, 2.2)]
    system = TipScript(points, hold=0.2, delay=0.3)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    fix(system, context, ground_valid=[1.0], tip_arrived=[0.0])
    simulator.AdvanceTo(0.25)
    assert np.isnan(at(system, context, "tip_command")).all()
    simulator.AdvanceTo(1.0)
    np.testing.assert_array_equal(at(system, context, "tip_command"), points[0])
    fix(system, context, tip_arrived=[1.0])
    simulator.AdvanceTo(1.15)
    assert at(system, context, "points_done") == 0.0
    simulator.AdvanceTo(1.25)
    assert at(system, context, "points_done") == 1.0
    np.testing.assert_array_equal(at(system, context, "tip_command"), points[1])
    simulator.AdvanceTo(2.0)
    assert at(system, context, "points_done") == 2.0


# --- the platform's pose, as it is measured


def loop_on(carried, posture, **settings):
    """The loop, without a goal, on a platform that stands in a posture."""
    system = TipLoop(carried)
    context = system.CreateDefaultContext()
    extension = inverse_kinematics(carried.geometry, posture, carried.ground, carried.foot_offsets)
    values = {
        "attitude": posture[:2],
        "extension_measured": extension,
        "ground": carried.ground,
        "foot_offsets": carried.foot_offsets,
        "arm_position": [0.4, 0.5],
        "enable": [1.0],
    }
    fix(system, context, **(values | settings))
    return system, context


def test_the_tip_stands_on_the_measured_pose_as_the_chain_has_it():
    carried = replace(CARRIED, ground=(0.03, 0.05), foot_offsets=(0.0, 4e-3, 2e-3, 0.0))
    posture = [0.01, -0.02, 0.476]
    system, context = loop_on(carried, posture)
    np.testing.assert_allclose(at(system, context, "posture_measured"), posture, atol=1e-9)
    pose = at(system, context, "platform_pose_measured")
    tip = ArmTip(carried.arm)
    on_tip = tip.CreateDefaultContext()
    fix(tip, on_tip, platform_pose=pose, arm_state=[0.4, 0.5, 0.0, 0.0])
    place = at(tip, on_tip, "pose")[4:]
    np.testing.assert_allclose(place, at(system, context, "tip_estimated"), atol=1e-9)


def test_a_pose_on_ground_that_is_not_known_is_not_a_number():
    for settings in ({"enable": [0.0]}, {"attitude": [math.nan, 0.0]}):
        system, context = loop_on(CARRIED, LEVEL, **settings)
        assert np.isnan(at(system, context, "platform_pose_measured")).all()
