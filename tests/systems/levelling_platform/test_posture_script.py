import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.scripts import PostureScript, Waypoint

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


@pytest.mark.parametrize(
    ("name", "value"), [("ground_estimated", (0.05, 0.05)), ("ground_valid", (0.0,))]
)
def test_each_input_moves_the_outputs(fix, name, value):
    one, other = Script(fix), Script(fix)
    other.set(**{name: value})
    assert (one.run(2.5) != other.run(2.5)).any()
    assert one.scale != other.scale


def test_late_updates_skip_to_the_waypoint_whose_time_has_come(fix):
    script = Script(fix, period=2.4)
    np.testing.assert_allclose(script.run(2.5), posture(WAYPOINTS[1]), atol=1e-15)
    np.testing.assert_allclose(script.run(5.0), posture(WAYPOINTS[2]), atol=1e-15)


def test_command_is_held_between_updates(fix, moved):
    script = Script(fix)
    script.run(0.5)
    assert moved(script.system, script.context, lambda: script.context.SetTime(1.5)) == set()


def test_no_output_depends_on_an_input_directly():
    assert not PostureScript().HasAnyDirectFeedthrough()
