"""Scripts of postures, and of an operator's steps."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.scripts import (
    OperatorScript,
    PostureScript,
    Step,
    Waypoint,
)
from parapod.systems.levelling_platform.supervisor import Command, Phase

PERIOD = 0.01
POSTURE = (0.01, -0.02, 0.47)
OUTPUTS = ("operator", "drive_request", "posture_request", "arm_request", "steps_done")


class Operator:
    """An operator at whom the test shows phases."""

    def __init__(self, fix, *steps, phase=Phase.TRANSPORT):
        self.system = OperatorScript(steps, POSTURE, PERIOD)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self._fix = fix
        self.show(phase)

    def show(self, phase):
        self._fix(self.system, self.context, phase=(float(phase),))

    def after(self, time):
        """Outputs a time later, by name."""
        # Half a period on, so that it is clear which updates have been made.
        goal = round((self.context.get_time() + time) / PERIOD) * PERIOD + 0.1 * PERIOD
        self.simulator.AdvanceTo(goal)
        return {
            name: self.system.GetOutputPort(name).Eval(self.context).tolist() for name in OUTPUTS
        }


def test_without_steps_nothing_is_asked_for_but_the_first_posture(fix):
    assert Operator(fix).after(1.0) == {
        "operator": [0.0],
        "drive_request": [0.0, 0.0],
        "posture_request": list(POSTURE),
        "arm_request": [0.0, 0.0],
        "steps_done": [0.0],
    }


def test_a_step_does_all_that_it_names(fix):
    step = Step(Phase.TRANSPORT, 0.0, Command.GO, (0.3, 0.1), (0.0, 0.01, 0.48), (0.5, 0.6))
    assert Operator(fix, step).after(0.1) == {
        "operator": [1.0],
        "drive_request": [0.3, 0.1],
        "posture_request": [0.0, 0.01, 0.48],
        "arm_request": [0.5, 0.6],
        "steps_done": [1.0],
    }


def test_what_a_step_does_not_name_stays_but_its_command_is_taken_back(fix):
    first = Step(Phase.TRANSPORT, 0.0, Command.GO, (0.3, 0.1), (0.0, 0.01, 0.48), (0.5, 0.6))
    operator = Operator(fix, first, Step(Phase.TRANSPORT, 0.5))
    before = operator.after(0.4)
    after = operator.after(0.2)
    assert (before["operator"], after["operator"]) == ([1.0], [0.0])
    assert (before["steps_done"], after["steps_done"]) == ([1.0], [2.0])
    for name in ("drive_request", "posture_request", "arm_request"):
        assert after[name] == before[name]


def test_a_step_waits_for_its_delay_after_the_one_before(fix):
    steps = [Step(Phase.TRANSPORT, 0.3, drive=(v, 0.0)) for v in (0.1, 0.2)]
    operator = Operator(fix, *steps)
    assert operator.after(0.29)["steps_done"] == [0.0]
    assert operator.after(0.01)["drive_request"] == [0.1, 0.0]
    assert operator.after(0.29)["steps_done"] == [1.0]
    assert operator.after(0.01)["drive_request"] == [0.2, 0.0]


def test_a_step_waits_for_its_phase_and_then_for_its_delay(fix):
    operator = Operator(fix, Step(Phase.HOLD, 0.2, Command.STOP))
    assert operator.after(5.0)["steps_done"] == [0.0]
    operator.show(Phase.HOLD)
    assert operator.after(0.2)["steps_done"] == [0.0]
    assert operator.after(0.01)["operator"] == [float(Command.STOP)]


def test_the_delay_begins_anew_when_the_phase_comes_back(fix):
    operator = Operator(fix, Step(Phase.HOLD, 0.2, Command.STOP), phase=Phase.HOLD)
    operator.after(0.1)
    operator.show(Phase.POSTURE)
    operator.after(0.05)
    operator.show(Phase.HOLD)
    assert operator.after(0.2)["steps_done"] == [0.0]
    assert operator.after(0.01)["steps_done"] == [1.0]


def test_steps_are_done_in_their_order(fix):
    operator = Operator(
        fix, Step(Phase.HOLD, 0.0, arm=(0.1, 0.2)), Step(Phase.TRANSPORT, 0.0, drive=(0.3, 0.0))
    )
    assert operator.after(1.0)["steps_done"] == [0.0]
    operator.show(Phase.HOLD)
    assert operator.after(1.0)["steps_done"] == [1.0]
    operator.show(Phase.TRANSPORT)
    assert operator.after(1.0)["steps_done"] == [2.0]


def test_one_step_a_period_at_most(fix):
    steps = [Step(Phase.TRANSPORT, 0.0)] * 3
    operator = Operator(fix, *steps)
    done = [operator.after(t)["steps_done"][0] for t in (0.0, 0.01, 0.01, 0.01)]
    assert done == [1.0, 2.0, 3.0, 3.0]


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_phase_that_is_not_finite_is_none_that_a_step_waits_for(fix, bad):
    operator = Operator(fix, Step(Phase.TRANSPORT, 0.1), phase=bad)
    assert operator.after(1.0)["steps_done"] == [0.0]
    operator.show(Phase.TRANSPORT)
    assert operator.after(0.1)["steps_done"] == [0.0]
    assert operator.after(0.01)["steps_done"] == [1.0]


GEOMETRY = PlatformGeometry(foot_radius=0.025)
HEIGHT = 0.477
WAYPOINTS = (
    Waypoint(1.0, roll=0.03),
    Waypoint(2.0, pitch=-0.04),
    Waypoint(3.0, roll=-0.02, pitch=0.03, height=0.01),
)
LEVEL = (0.0, 0.0, HEIGHT)


class Script:
    def __init__(self, fix, waypoints=WAYPOINTS, ground=(0.0, 0.0), enable=1.0, **settings):
        self.system = PostureScript(GEOMETRY, HEIGHT, waypoints, **settings)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self._fix = fix
        self.set(ground_estimated=ground, ground_valid=(enable,))

    def set(self, **inputs):
        self._fix(self.system, self.context, **inputs)

    def run(self, until):
        self.simulator.AdvanceTo(until)
        return self.system.GetOutputPort("posture_command").Eval(self.context).copy()

    @property
    def scale(self):
        return self.system.GetOutputPort("posture_scale").Eval(self.context)[0]


def posture(waypoint, scale=1.0):
    return np.array(
        (scale * waypoint.roll, scale * waypoint.pitch, HEIGHT + scale * waypoint.height)
    )


def test_level_posture_is_commanded_before_the_script_begins(fix):
    script = Script(fix, enable=0.0)
    for until in (0.0, 5.0):
        np.testing.assert_array_equal(script.run(until), LEVEL)


def test_waypoints_are_commanded_each_at_its_time(fix):
    script = Script(fix)
    np.testing.assert_array_equal(script.run(0.5), LEVEL)
    assert script.scale == 1.0
    for waypoint in WAYPOINTS:
        assert (script.run(waypoint.time - 0.001) != posture(waypoint)).any()
        for until in (waypoint.time + 0.001, waypoint.time + 0.9):
            np.testing.assert_allclose(script.run(until), posture(waypoint), atol=1e-15)
    np.testing.assert_allclose(script.run(60.0), posture(WAYPOINTS[-1]), atol=1e-15)


def test_times_count_from_the_moment_the_script_begins(fix):
    script = Script(fix, enable=0.0)
    script.run(4.205)
    script.set(ground_valid=(1.0,))
    np.testing.assert_array_equal(script.run(5.209), LEVEL)
    np.testing.assert_allclose(script.run(5.211), posture(WAYPOINTS[0]), atol=1e-15)


def test_waypoint_at_zero_is_commanded_when_the_script_begins(fix):
    script = Script(fix, waypoints=(Waypoint(0.0, roll=0.02),))
    np.testing.assert_allclose(script.run(0.005), (0.02, 0.0, HEIGHT), atol=1e-15)


def test_disabling_returns_to_the_level_posture_and_enabling_begins_anew(fix):
    script = Script(fix)
    script.run(2.5)
    script.set(ground_valid=(0.0,))
    np.testing.assert_array_equal(script.run(2.6), LEVEL)
    assert script.scale == 0.0
    script.set(ground_valid=(1.0,))
    np.testing.assert_array_equal(script.run(3.5), LEVEL)
    np.testing.assert_allclose(script.run(3.7), posture(WAYPOINTS[0]), atol=1e-15)


def fits(scale, waypoints, ground, margin):
    wide = PlatformGeometry(foot_radius=0.025, extension_min=0.37, extension_max=0.44)
    postures = np.array([posture(waypoint, scale) for waypoint in waypoints])
    extension = inverse_kinematics(wide, postures, ground, on_unreachable="nan")
    return bool(((extension >= 0.390 + margin) & (extension <= 0.420 - margin)).all())


@pytest.mark.parametrize(
    "ground", [(0.0, 0.0), (0.02, 0.03), (math.radians(2.0), math.radians(4.0)), (0.0, -0.087)]
)
@pytest.mark.parametrize("margin", [0.0, 0.3e-3, 1e-3])
def test_scale_is_the_largest_hundredth_with_which_all_waypoints_fit(fix, ground, margin):
    large = tuple(Waypoint(w.time, 3.0 * w.roll, 3.0 * w.pitch, 3.0 * w.height) for w in WAYPOINTS)
    script = Script(fix, waypoints=large, ground=ground, margin=margin)
    script.run(0.05)
    scale = script.scale
    assert scale == pytest.approx(round(scale, 2), abs=1e-12)
    assert 0.0 < scale < 1.0
    assert fits(scale, large, ground, margin)
    assert not fits(scale + 0.01, large, ground, margin)
    for waypoint in large:
        np.testing.assert_allclose(
            script.run(waypoint.time + 0.001), posture(waypoint, scale), rtol=0, atol=1e-15
        )


def test_scale_is_zero_where_not_even_the_level_posture_fits(fix):
    script = Script(fix, ground=np.radians((5.0, 5.0)))
    np.testing.assert_array_equal(script.run(2.5), LEVEL)
    assert script.scale == 0.0


def test_script_without_waypoints_stays_level(fix):
    script = Script(fix, waypoints=())
    np.testing.assert_array_equal(script.run(9.0), LEVEL)
    assert script.scale == 1.0


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_ground_that_is_not_finite_does_not_start_the_script(fix, bad):
    script = Script(fix, ground=(0.0, bad))
    np.testing.assert_array_equal(script.run(1.5), LEVEL)
    script.set(ground_estimated=(0.0, 0.0))
    np.testing.assert_array_equal(script.run(2.4), LEVEL)
    np.testing.assert_allclose(script.run(2.6), posture(WAYPOINTS[0]), atol=1e-15)


def test_enable_that_is_nan_does_not_start_the_script(fix):
    np.testing.assert_array_equal(Script(fix, enable=math.nan).run(2.5), LEVEL)


def test_ground_that_changes_later_does_not_rescale_a_running_script(fix):
    script = Script(fix)
    script.run(1.5)
    script.set(ground_estimated=np.radians((5.0, 5.0)))
    np.testing.assert_allclose(script.run(2.5), posture(WAYPOINTS[1]), atol=1e-15)


def test_waypoints_out_of_order_are_refused():
    with pytest.raises(ValueError, match="times"):
        PostureScript(GEOMETRY, waypoints=(Waypoint(2.0), Waypoint(1.0)))


def test_late_updates_skip_to_the_waypoint_whose_time_has_come(fix):
    script = Script(fix, period=2.4)
    np.testing.assert_allclose(script.run(2.5), posture(WAYPOINTS[1]), atol=1e-15)
    np.testing.assert_allclose(script.run(5.0), posture(WAYPOINTS[2]), atol=1e-15)
