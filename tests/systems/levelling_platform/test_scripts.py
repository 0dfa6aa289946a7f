"""Scripts of postures, and of an operator's steps."""

import itertools
import math

import numpy as np
import pytest

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


@pytest.fixture
def operator(stand):
    """operator(*steps, phase=...): an operator who sees that phase."""

    class Operator(stand):
        @property
        def asks(self):
            """Outputs by name."""
            return {name: self[name].tolist() for name in OUTPUTS}

        @property
        def done(self):
            """Steps that have been done."""
            return self["steps_done"].item()

    def begin(*steps, phase=Phase.TRANSPORT):
        return Operator(OperatorScript(steps, POSTURE, PERIOD), phase=phase)

    return begin


def test_without_steps_nothing_is_asked_for_but_the_first_posture(operator):
    assert operator().tick(10).asks == {
        "operator": [0.0],
        "drive_request": [0.0, 0.0],
        "posture_request": list(POSTURE),
        "arm_request": [0.0, 0.0],
        "steps_done": [0.0],
    }


def test_a_step_does_all_that_it_names_and_the_next_takes_back_its_command_alone(operator):
    step = Step(Phase.TRANSPORT, 0.0, Command.GO, (0.3, 0.1), (0.0, 0.01, 0.48), (0.5, 0.6))
    script = operator(step, Step(Phase.TRANSPORT, 0.5))
    asked = {
        "operator": [1.0],
        "drive_request": [0.3, 0.1],
        "posture_request": [0.0, 0.01, 0.48],
        "arm_request": [0.5, 0.6],
        "steps_done": [1.0],
    }
    assert script.tick(40).asks == asked
    assert script.tick(20).asks == asked | {"operator": [0.0], "steps_done": [2.0]}


def test_a_step_waits_for_its_phase_and_then_for_its_delay_after_the_one_before(operator):
    steps = [Step(Phase.HOLD, 0.3, drive=(v, 0.0)) for v in (0.1, 0.2)]
    script = operator(*steps)
    assert script.tick(500).done == 0.0
    assert script.tick(30, phase=Phase.HOLD).done == 0.0
    assert script.tick()["drive_request"].tolist() == [0.1, 0.0]
    assert script.tick(29).done == 1.0
    assert script.tick()["drive_request"].tolist() == [0.2, 0.0]


def test_the_delay_begins_anew_when_the_phase_comes_back(operator):
    script = operator(Step(Phase.HOLD, 0.2, Command.STOP), phase=Phase.HOLD)
    script.tick(10).tick(5, phase=Phase.POSTURE)
    assert script.tick(20, phase=Phase.HOLD).done == 0.0
    assert script.tick().done == 1.0


def test_steps_are_done_in_their_order_and_one_a_period_at_most(operator):
    steps = Step(Phase.HOLD, 0.0, arm=(0.1, 0.2)), *[Step(Phase.TRANSPORT, 0.0)] * 3
    script = operator(*steps)
    assert script.tick(10).done == 0.0
    assert script.tick(10, phase=Phase.HOLD).done == 1.0
    script.set(phase=Phase.TRANSPORT)
    assert [script.tick().done for _ in range(4)] == [2.0, 3.0, 4.0, 4.0]


def test_a_phase_that_is_not_finite_is_none_that_a_step_waits_for(operator):
    for bad in (math.nan, math.inf):
        script = operator(Step(Phase.TRANSPORT, 0.1), phase=bad)
        assert script.tick(100).done == 0.0
        assert script.tick(10, phase=Phase.TRANSPORT).done == 0.0
        assert script.tick().done == 1.0


# Postures


GEOMETRY = PlatformGeometry(foot_radius=0.025)
HEIGHT = 0.477
WAYPOINTS = (
    Waypoint(1.0, roll=0.03),
    Waypoint(2.0, pitch=-0.04),
    Waypoint(3.0, roll=-0.02, pitch=0.03, height=0.01),
)
LEVEL = (0.0, 0.0, HEIGHT)


@pytest.fixture
def script(stand):
    """script(waypoints, ground, enable, **settings): a script on that ground."""

    class Script(stand):
        def commands(self, until):
            """The posture that is asked for at a time."""
            return self.run(until)["posture_command"]

        @property
        def scale(self):
            return self["posture_scale"].item()

    def begin(waypoints=WAYPOINTS, ground=(0.0, 0.0), enable=1.0, **settings):
        system = PostureScript(GEOMETRY, HEIGHT, waypoints, **settings)
        return Script(system, ground_estimated=ground, ground_valid=enable)

    return begin


def posture(waypoint, scale=1.0):
    return np.array(
        (scale * waypoint.roll, scale * waypoint.pitch, HEIGHT + scale * waypoint.height)
    )


def test_waypoints_are_commanded_each_at_its_time_from_the_moment_the_script_begins(script):
    running = script(enable=0.0)
    np.testing.assert_array_equal(running.commands(4.205), LEVEL)
    running.set(ground_valid=1.0)
    for last, waypoint in itertools.pairwise((Waypoint(0.0), *WAYPOINTS)):
        np.testing.assert_allclose(
            running.commands(4.209 + waypoint.time), posture(last), atol=1e-15
        )
        np.testing.assert_allclose(
            running.commands(4.211 + waypoint.time), posture(waypoint), atol=1e-15
        )
    assert running.scale == 1.0
    np.testing.assert_allclose(running.commands(60.0), posture(WAYPOINTS[-1]), atol=1e-15)


def test_a_waypoint_at_zero_is_commanded_when_the_script_begins(script):
    running = script(waypoints=(Waypoint(0.0, roll=0.02),))
    np.testing.assert_allclose(running.commands(0.005), (0.02, 0.0, HEIGHT), atol=1e-15)


def test_disabling_returns_to_the_level_posture_and_enabling_begins_anew(script):
    running = script().run(2.5).set(ground_valid=0.0)
    np.testing.assert_array_equal(running.commands(2.6), LEVEL)
    assert running.scale == 0.0
    running.set(ground_valid=1.0)
    np.testing.assert_array_equal(running.commands(3.5), LEVEL)
    np.testing.assert_allclose(running.commands(3.7), posture(WAYPOINTS[0]), atol=1e-15)


def fits(scale, waypoints, ground, margin):
    wide = PlatformGeometry(foot_radius=0.025, extension_min=0.37, extension_max=0.44)
    postures = np.array([posture(waypoint, scale) for waypoint in waypoints])
    extension = inverse_kinematics(wide, postures, ground, on_unreachable="nan")
    return bool(((extension >= 0.390 + margin) & (extension <= 0.420 - margin)).all())


@pytest.mark.parametrize(
    ("ground", "margin", "down"),
    [
        ((0.0, 0.0), 0.3e-3, False),
        ((0.02, 0.03), 1e-3, False),
        ((0.0, -0.087), 0.0, False),
        ((0.0, 0.0), 1e-3, True),
    ],
)
def test_scale_is_the_largest_hundredth_with_which_all_waypoints_fit(script, ground, margin, down):
    large = tuple(Waypoint(w.time, 3.0 * w.roll, 3.0 * w.pitch, 3.0 * w.height) for w in WAYPOINTS)
    if down:
        # The longest extension decides, in place of the shortest.
        large = (Waypoint(1.0, height=-0.15),)
    running = script(waypoints=large, ground=ground, margin=margin).run(0.05)
    scale = running.scale
    assert scale == pytest.approx(round(scale, 2), abs=1e-12)
    assert 0.0 < scale < 1.0
    assert fits(scale, large, ground, margin)
    assert not fits(scale + 0.01, large, ground, margin)
    for waypoint in large:
        np.testing.assert_allclose(
            running.commands(waypoint.time + 0.001), posture(waypoint, scale), rtol=0, atol=1e-15
        )


def test_scale_is_zero_where_not_even_the_level_posture_fits(script):
    running = script(ground=np.radians((5.0, 5.0)))
    np.testing.assert_array_equal(running.commands(2.5), LEVEL)
    assert running.scale == 0.0


def test_a_script_without_waypoints_stays_level(script):
    running = script(waypoints=())
    np.testing.assert_array_equal(running.commands(9.0), LEVEL)
    assert running.scale == 1.0


def test_a_script_does_not_start_before_ground_and_enable_are_finite(script):
    running = script(ground=(0.0, math.nan))
    np.testing.assert_array_equal(running.commands(1.5), LEVEL)
    running.set(ground_estimated=(0.0, 0.0), ground_valid=math.nan)
    np.testing.assert_array_equal(running.commands(3.0), LEVEL)
    running.set(ground_valid=1.0)
    np.testing.assert_array_equal(running.commands(3.9), LEVEL)
    np.testing.assert_allclose(running.commands(4.1), posture(WAYPOINTS[0]), atol=1e-15)


def test_ground_that_changes_later_does_not_rescale_a_running_script(script):
    running = script().run(1.5).set(ground_estimated=np.radians((5.0, 5.0)))
    np.testing.assert_allclose(running.commands(2.5), posture(WAYPOINTS[1]), atol=1e-15)


def test_waypoints_out_of_order_are_refused():
    with pytest.raises(ValueError, match="times"):
        PostureScript(GEOMETRY, waypoints=(Waypoint(2.0), Waypoint(1.0)))


def test_late_updates_skip_to_the_waypoint_whose_time_has_come(script):
    running = script(period=2.4)
    np.testing.assert_allclose(running.commands(2.5), posture(WAYPOINTS[1]), atol=1e-15)
    np.testing.assert_allclose(running.commands(5.0), posture(WAYPOINTS[2]), atol=1e-15)
