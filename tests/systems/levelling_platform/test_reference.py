import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import (
    height_range,
    inverse_kinematics,
)
from parapod.systems.levelling_platform.reference import PostureReference, PostureReferenceParams

GEOMETRY = PlatformGeometry(foot_radius=0.025)
PARAMS = PostureReferenceParams()
LIMITS = np.array((PARAMS.angle_rate, PARAMS.angle_rate, PARAMS.height_rate))
GROUND = np.array((0.02, -0.03))
START = np.array((0.015, -0.02, 0.46))
COMMAND = np.array((-0.01, 0.01, 0.48))
PERIOD = 0.01


class Reference:
    """A reference whose inputs are fixed by the test."""

    def __init__(self, fix, on_unreachable="raise", params=PARAMS, **inputs):
        self.system = PostureReference(GEOMETRY, params, on_unreachable, PERIOD)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self._fix = fix
        self.set(
            **(
                {
                    "posture_command": COMMAND,
                    "extension_measured": inverse_kinematics(GEOMETRY, START, GROUND),
                    "ground": GROUND,
                    "enable": (1.0,),
                }
                | inputs
            )
        )

    def set(self, **inputs):
        self._fix(self.system, self.context, **inputs)

    def output(self, context=None):
        """Posture and rate."""
        port = self.system.GetOutputPort("posture_desired_state")
        return np.split(port.Eval(self.context if context is None else context).copy(), 2)

    @property
    def posture(self):
        return self.output()[0]

    @property
    def rate(self):
        return self.output()[1]

    def run(self, until):
        self.simulator.AdvanceTo(until)
        return self.output()

    def at(self, time):
        """Posture and rate that the present plan has at another time."""
        context = self.context.Clone()
        context.SetTime(time)
        return self.output(context)

    def acceleration(self, time, side):
        """One-sided second derivative of the present plan."""
        step = 1e-6 * side
        return (self.at(time + step)[1] - self.at(time)[1]) / step

    def record(self, until, step=0.002):
        """Times, postures and rates on a grid."""
        times = np.arange(self.context.get_time() + step, until, step)
        samples = [self.run(float(t)) for t in times]
        postures, rates = np.array(samples).transpose(1, 0, 2)
        return times, postures, rates


def test_it_starts_at_the_measured_posture_at_rest(fix):
    reference = Reference(fix, enable=(0.0,))
    reference.run(0.205)
    reference.set(enable=(1.0,))
    posture, rate = reference.run(0.21 + 1e-9)
    np.testing.assert_allclose(posture, START, rtol=0, atol=1e-13)
    np.testing.assert_allclose(rate, 0.0, atol=1e-12)
    np.testing.assert_allclose(reference.acceleration(0.21, 1.0), 0.0, atol=1e-5)


def test_it_ends_exactly_at_the_command_and_stays(fix):
    reference = Reference(fix)
    for until in (4.0, 10.0):
        posture, rate = reference.run(until)
        np.testing.assert_allclose(posture, COMMAND, rtol=0, atol=1e-15)
        np.testing.assert_allclose(rate, 0.0, atol=1e-15)


def test_rate_is_the_derivative_of_the_posture(fix):
    reference = Reference(fix)
    times, postures, rates = reference.record(3.0, step=0.0005)
    difference = (postures[2:] - postures[:-2]) / (times[2:] - times[:-2])[:, np.newaxis]
    np.testing.assert_allclose(rates[1:-1], difference, atol=1e-6)


def test_acceleration_does_not_jump(fix):
    reference = Reference(fix)
    jumps = []
    for step in (0.02, 0.01):
        again = Reference(fix)
        times, _, rates = again.record(3.0, step=step)
        acceleration = np.diff(rates, axis=0) / np.diff(times)[:, np.newaxis]
        jumps.append(np.abs(np.diff(acceleration, axis=0)).max())
    # Differences of a continuous function go with the step; those of a jump would not.
    assert jumps[0] / jumps[1] == pytest.approx(2.0, rel=0.25)
    np.testing.assert_allclose(reference.at(0.0)[1], 0.0, atol=1e-15)


@pytest.mark.parametrize(
    "command",
    [
        COMMAND,
        np.add(START, (0.02, 0.0, 0.0)),
        np.add(START, (0.0, 0.02, 0.0)),
        np.add(START, (0.0, 0.0, 0.02)),
    ],
)
def test_move_from_rest_to_rest_peaks_at_the_limiting_rate(fix, command):
    _, _, rates = Reference(fix, posture_command=command).record(4.0)
    share = (np.abs(rates) / LIMITS).max()
    assert share <= 1.0 + 1e-9
    assert share == pytest.approx(1.0, abs=1e-4)


def test_params_scale_the_rates(fix):
    slow = replace(PARAMS, angle_rate=0.5 * PARAMS.angle_rate, height_rate=0.01)
    _, _, rates = Reference(fix, params=slow).record(6.0)
    assert (2.0 * np.abs(rates) / LIMITS).max() == pytest.approx(1.0, abs=1e-4)


def test_small_move_takes_the_shortest_duration(fix):
    reference = Reference(fix, posture_command=np.add(START, (1e-5, 0.0, 0.0)))
    before, _ = reference.run(PARAMS.shortest_move - 0.05)
    after, _ = reference.run(PARAMS.shortest_move)
    assert START[0] < before[0] < START[0] + 1e-5
    np.testing.assert_allclose(after[0], START[0] + 1e-5, rtol=0, atol=1e-15)


def test_move_is_straight_and_does_not_overshoot(fix):
    _, postures, _ = Reference(fix).record(4.0)
    share = (postures - START) / (COMMAND - START)
    np.testing.assert_allclose(share, share[:, :1] * np.ones(3), atol=1e-9)
    assert share.max() <= 1.0 + 1e-12
    assert (np.diff(share[:, 0]) >= -1e-12).all()


@pytest.mark.parametrize("instant", [0.4, 0.8, 1.3])
def test_replanning_is_continuous_in_posture_rate_and_acceleration(fix, instant):
    reference = Reference(fix)
    before = *reference.run(instant), reference.acceleration(instant, -1.0)
    assert np.abs(before[1]).max() > 1e-4
    reference.set(posture_command=(0.02, -0.03, 0.465))
    reference.run(instant + 1e-9)  # the update at the instant plans anew
    after = *reference.at(instant), reference.acceleration(instant, 1.0)
    np.testing.assert_allclose(after[0], before[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(after[1], before[1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(after[2], before[2], rtol=0, atol=1e-5)
    assert np.abs(before[2]).max() > 1e-3
    posture, rate = reference.run(6.0)
    np.testing.assert_allclose(posture, (0.02, -0.03, 0.465), rtol=0, atol=1e-15)
    np.testing.assert_allclose(rate, 0.0, atol=1e-15)


def test_commands_that_chase_each_other_stay_continuous(fix):
    reference = Reference(fix)
    rng = np.random.default_rng(0)
    postures, time = [], 0.0
    for _ in range(20):
        low, high = height_range(GEOMETRY, (0.0, 0.0), GROUND)
        command = np.append(rng.uniform(-0.01, 0.01, 2), rng.uniform(low + 0.01, high - 0.01))
        reference.set(posture_command=command)
        time += 0.1
        postures.append(reference.record(time)[1])
    steps = np.abs(np.diff(np.concatenate(postures), axis=0)) / 0.002
    # Moves that begin in motion may exceed the limits a little, but nothing jumps.
    assert (steps / LIMITS).max() < 3.0


def test_same_command_again_changes_nothing(fix):
    steady, repeated = Reference(fix), Reference(fix)
    steady.run(0.5)
    for k in range(1, 6):
        repeated.set(posture_command=COMMAND.copy())
        repeated.run(0.1 * k)
    np.testing.assert_array_equal(repeated.posture, steady.posture)


def test_measurements_do_not_matter_once_it_has_started(fix):
    reference = Reference(fix)
    reference.run(0.5)
    before = reference.posture
    reference.set(extension_measured=np.full(4, math.nan))
    np.testing.assert_array_equal(reference.posture, before)
    np.testing.assert_allclose(reference.run(5.0)[0], COMMAND, rtol=0, atol=1e-15)


def test_disabling_returns_to_the_measured_posture_and_enabling_starts_anew(fix):
    reference = Reference(fix)
    reference.run(0.5)
    reference.set(enable=(0.0,))
    posture, rate = reference.run(0.52)
    np.testing.assert_allclose(posture, START, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(rate, np.zeros(3))
    reference.set(enable=(1.0,))
    posture, _ = reference.run(0.52 + 1e-6)
    np.testing.assert_allclose(posture, START, rtol=0, atol=1e-12)
    np.testing.assert_allclose(reference.run(6.0)[0], COMMAND, rtol=0, atol=1e-15)


# Bad input


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_command_that_is_not_finite_is_ignored(fix, bad):
    reference = Reference(fix)
    reference.run(0.5)
    undisturbed = reference.at(1.0)
    reference.set(posture_command=(0.0, bad, 0.47))
    disturbed = reference.run(1.0)
    np.testing.assert_array_equal(disturbed, undisturbed)


def test_command_that_is_not_finite_does_not_start_it(fix):
    reference = Reference(fix, posture_command=np.full(3, math.nan))
    posture, rate = reference.run(0.5)
    np.testing.assert_allclose(posture, START, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(rate, np.zeros(3))
    reference.set(posture_command=COMMAND)
    np.testing.assert_allclose(reference.run(6.0)[0], COMMAND, rtol=0, atol=1e-15)


def test_ground_that_is_not_finite_is_ignored(fix):
    reference = Reference(fix)
    reference.run(0.5)
    undisturbed = reference.at(1.0)
    reference.set(ground=(math.nan, 0.0))
    np.testing.assert_array_equal(reference.run(1.0), undisturbed)


def test_measurement_that_is_nan_at_the_start_does_not_spoil_the_reference_for_good(fix):
    good = inverse_kinematics(GEOMETRY, START, GROUND)
    reference = Reference(fix, extension_measured=np.full(4, math.nan))
    reference.run(0.005)
    reference.set(extension_measured=good)
    posture, rate = reference.run(6.0)
    np.testing.assert_allclose(posture, COMMAND, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rate, 0.0, atol=1e-12)


# Unreachable commands


def test_unreachable_command_stops_the_simulation_and_tells_the_admissible_heights(fix):
    command = (0.0, 0.0, 0.7)
    reference = Reference(fix, posture_command=command)
    with pytest.raises(UnreachablePosture) as caught:
        reference.run(0.1)
    low, high = 1e3 * height_range(GEOMETRY, command[:2], GROUND)
    assert f"{low:.1f}..{high:.1f} mm" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.admissible == (0.390, 0.420)
    assert caught.value.leg in (1, 2, 3, 4)
    np.testing.assert_allclose(reference.posture, START, rtol=0, atol=1e-13)


def test_attitude_that_fits_no_height_is_said_to_fit_none(fix):
    reference = Reference(fix, posture_command=(0.2, 0.2, 0.47))
    with pytest.raises(UnreachablePosture, match="no height fits"):
        reference.run(0.1)


def test_heights_named_by_the_error_are_reachable(fix):
    low, high = height_range(GEOMETRY, (0.0, 0.0), GROUND)
    for height in (low, high):
        reference = Reference(fix, posture_command=(0.0, 0.0, height))
        np.testing.assert_allclose(reference.run(9.0)[0][2], height, rtol=0, atol=1e-15)


@pytest.mark.parametrize("command", [(0.0, 0.0, 0.7), (0.0, 0.0, 0.3), (0.3, -0.3, 0.47)])
def test_clamped_command_gives_way_in_height_and_then_in_its_angles(fix, command):
    reference = Reference(fix, "clamp", posture_command=command)
    _, postures, rates = reference.record(20.0, step=0.05)
    inverse_kinematics(GEOMETRY, postures, GROUND)  # raises where one is out of reach
    end = postures[-1]
    low, high = height_range(GEOMETRY, end[:2], GROUND)
    assert end[2] == pytest.approx(np.clip(command[2], low, high), abs=1e-12)
    np.testing.assert_allclose(rates[-1], 0.0, atol=1e-12)

    low, high = height_range(GEOMETRY, command[:2], GROUND)
    if low <= high:
        np.testing.assert_allclose(end[:2], command[:2], rtol=0, atol=1e-12)
        return
    way = np.array(command[:2]) - START[:2]
    share = np.dot(end[:2] - START[:2], way) / np.dot(way, way)
    np.testing.assert_allclose(end[:2], START[:2] + share * way, rtol=0, atol=1e-12)
    low, high = height_range(GEOMETRY, START[:2] + (share + 1.0 / 128.0) * way, GROUND)
    assert low > high


def test_clamped_command_is_the_same_wherever_it_comes_from(fix):
    high = (0.0, 0.0, 0.57)
    direct = Reference(fix, "clamp", posture_command=high).run(20.0)[0]
    detour = Reference(fix, "clamp", posture_command=(0.1, 0.1, 0.39))
    detour.run(10.0)
    detour.set(posture_command=high)
    np.testing.assert_allclose(detour.run(30.0)[0], direct, rtol=0, atol=1e-12)
    np.testing.assert_allclose(direct[:2], 0.0, atol=1e-12)


def test_reachable_command_is_not_clamped(fix):
    reference = Reference(fix, "clamp")
    np.testing.assert_allclose(reference.run(6.0)[0], COMMAND, rtol=0, atol=1e-15)


def test_ground_that_changes_is_planned_for_anew(fix):
    reference = Reference(fix, posture_command=(0.0, 0.0, 0.5))
    reference.run(0.5)
    reference.set(ground=np.radians((5.0, 5.0)))
    with pytest.raises(UnreachablePosture, match="no height fits"):
        reference.run(0.6)


def test_unknown_treatment_of_unreachable_commands_is_refused():
    with pytest.raises(ValueError, match="on_unreachable"):
        PostureReference(GEOMETRY, on_unreachable="stop")
