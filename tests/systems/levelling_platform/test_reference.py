import math
from dataclasses import replace

import numpy as np
import pytest

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
OFFSETS = np.array((0.004, -0.003, 0.002, -0.005))
START = np.array((0.015, -0.02, 0.46))
COMMAND = np.array((-0.01, 0.01, 0.48))
PERIOD = 0.01


@pytest.fixture
def refer(stand):
    """refer(on_unreachable, params, **inputs): a reference from `START` to `COMMAND`."""

    class Reference(stand):
        @property
        def output(self):
            """Posture and rate."""
            return np.split(self["posture_desired_state"], 2)

        def at(self, time):
            """Posture and rate that the present plan has at another time."""
            now = self.context.get_time()
            self.context.SetTime(time)
            output = self.output
            self.context.SetTime(now)
            return output

        def acceleration(self, time, side):
            """One-sided second derivative of the present plan."""
            step = 1e-6 * side
            return (self.at(time + step)[1] - self.at(time)[1]) / step

        def record(self, until, step=0.002):
            """Times, postures and rates on a grid."""
            times = np.arange(self.context.get_time() + step, until, step)
            samples = [self.run(float(t)).output for t in times]
            return times, *np.array(samples).transpose(1, 0, 2)

        def assert_rests_at(self, posture):
            np.testing.assert_allclose(self.output[0], posture, rtol=0, atol=1e-12)
            np.testing.assert_allclose(self.output[1], 0.0, atol=1e-14)

    def begin(on_unreachable="raise", params=PARAMS, **inputs):
        given = {
            "posture_command": COMMAND,
            "extension_measured": inverse_kinematics(GEOMETRY, START, GROUND, OFFSETS),
            "ground": GROUND,
            "foot_offsets": OFFSETS,
            "enable": 1.0,
        }
        system = PostureReference(GEOMETRY, params, on_unreachable, PERIOD)
        return Reference(system, **(given | inputs))

    return begin


def test_it_starts_at_the_measured_posture_at_rest_and_ends_at_the_command(refer):
    reference = refer(enable=0.0).run(0.205)
    reference.set(enable=1.0).run(0.21 + 1e-9).assert_rests_at(START)
    np.testing.assert_allclose(reference.acceleration(0.21, 1.0), 0.0, atol=1e-5)
    for until in (4.0, 10.0):
        reference.run(until).assert_rests_at(COMMAND)


def test_rate_is_the_derivative_of_the_posture(refer):
    times, postures, rates = refer().record(3.0)
    difference = (postures[2:] - postures[:-2]) / (times[2:] - times[:-2])[:, np.newaxis]
    np.testing.assert_allclose(rates[1:-1], difference, atol=1e-6)


def test_acceleration_does_not_jump(refer):
    jumps = []
    for step in (0.02, 0.01):
        times, _, rates = refer().record(3.0, step=step)
        acceleration = np.diff(rates, axis=0) / np.diff(times)[:, np.newaxis]
        jumps.append(np.abs(np.diff(acceleration, axis=0)).max())
    # Differences of a continuous function go with the step; those of a jump would not.
    assert jumps[0] / jumps[1] == pytest.approx(2.0, rel=0.25)


@pytest.mark.parametrize(
    ("command", "params"),
    [
        (COMMAND, PARAMS),
        (np.add(START, (0.02, 0.0, 0.0)), PARAMS),
        (np.add(START, (0.0, 0.02, 0.0)), PARAMS),
        (np.add(START, (0.0, 0.0, 0.02)), PARAMS),
        (COMMAND, replace(PARAMS, angle_rate=0.5 * PARAMS.angle_rate, height_rate=0.01)),
    ],
)
def test_a_move_from_rest_to_rest_peaks_at_the_limiting_rate(refer, command, params):
    limits = np.array((params.angle_rate, params.angle_rate, params.height_rate))
    _, _, rates = refer(params=params, posture_command=command).record(6.0, step=0.005)
    share = (np.abs(rates) / limits).max()
    assert share <= 1.0 + 1e-9
    assert share == pytest.approx(1.0, abs=1e-4)


def test_a_small_move_takes_the_shortest_duration(refer):
    reference = refer(posture_command=np.add(START, (1e-5, 0.0, 0.0)))
    before, _ = reference.run(PARAMS.shortest_move - 0.05).output
    after, _ = reference.run(PARAMS.shortest_move).output
    assert START[0] < before[0] < START[0] + 1e-5
    np.testing.assert_allclose(after[0], START[0] + 1e-5, rtol=0, atol=1e-13)


def test_a_move_is_straight_and_does_not_overshoot(refer):
    _, postures, _ = refer().record(4.0, step=0.01)
    share = (postures - START) / (COMMAND - START)
    np.testing.assert_allclose(share, share[:, :1] * np.ones(3), atol=1e-9)
    assert share.max() <= 1.0 + 1e-12
    assert (np.diff(share[:, 0]) >= -1e-12).all()


@pytest.mark.parametrize("instant", [0.4, 0.8, 1.3])
def test_replanning_is_continuous_in_posture_rate_and_acceleration(refer, instant):
    reference, other = refer(), (0.02, -0.03, 0.465)
    before = *reference.run(instant).output, reference.acceleration(instant, -1.0)
    assert np.abs(before[1]).max() > 1e-4
    assert np.abs(before[2]).max() > 1e-3
    reference.set(posture_command=other)
    reference.run(instant + 1e-9)  # the update at the instant plans anew
    after = *reference.at(instant), reference.acceleration(instant, 1.0)
    np.testing.assert_allclose(after[0], before[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(after[1], before[1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(after[2], before[2], rtol=0, atol=1e-5)
    reference.run(6.0).assert_rests_at(other)


def test_commands_that_chase_each_other_stay_continuous(refer):
    reference, rng = refer(), np.random.default_rng(0)
    low, high = height_range(GEOMETRY, (0.0, 0.0), GROUND, OFFSETS)
    postures = []
    for k in range(1, 21):
        command = np.append(rng.uniform(-0.01, 0.01, 2), rng.uniform(low + 0.01, high - 0.01))
        postures.append(reference.set(posture_command=command).record(0.1 * k)[1])
    steps = np.abs(np.diff(np.concatenate(postures), axis=0)) / 0.002
    # Moves that begin in motion may exceed the limits a little, but nothing jumps.
    assert (steps / LIMITS).max() < 3.0


@pytest.mark.parametrize(
    "inputs",
    [
        {"posture_command": COMMAND.copy()},
        {"posture_command": (0.0, math.nan, 0.47)},
        {"posture_command": (0.0, math.inf, 0.47)},
        {"ground": (math.nan, 0.0)},
        {"extension_measured": np.full(4, math.nan)},
    ],
)
def test_once_begun_it_goes_on_whatever_is_repeated_not_finite_or_measured(refer, inputs):
    steady, disturbed = refer(), refer()
    for k in range(5, 9):
        expected = steady.run(0.1 * k).output
        np.testing.assert_array_equal(disturbed.run(0.1 * k).output, expected)
        disturbed.set(**inputs)


def test_disabling_returns_to_the_measured_posture_and_enabling_starts_anew(refer):
    reference = refer().run(0.5).set(enable=0.0).run(0.52)
    reference.assert_rests_at(START)
    reference.set(enable=1.0).run(0.52 + 1e-6)
    np.testing.assert_allclose(reference.output[0], START, rtol=0, atol=1e-12)
    reference.run(6.0).assert_rests_at(COMMAND)


def test_it_does_not_start_before_command_and_measurement_are_finite(refer):
    reference = refer(posture_command=np.full(3, math.nan)).run(0.5)
    reference.assert_rests_at(START)
    reference.set(posture_command=COMMAND).run(6.0).assert_rests_at(COMMAND)
    good = inverse_kinematics(GEOMETRY, START, GROUND, OFFSETS)
    reference = refer(extension_measured=np.full(4, math.nan)).run(0.005)
    reference.set(extension_measured=good).run(6.0).assert_rests_at(COMMAND)


# Unreachable commands


def test_an_unreachable_command_stops_the_simulation_and_tells_the_admissible_heights(refer):
    reference = refer(posture_command=(0.0, 0.0, 0.7))
    with pytest.raises(UnreachablePosture) as caught:
        reference.run(0.1)
    low, high = 1e3 * height_range(GEOMETRY, (0.0, 0.0), GROUND, OFFSETS)
    assert f"the height must be {low:.1f}..{high:.1f} mm" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.admissible == (0.390, 0.420)
    assert caught.value.leg in (1, 2, 3, 4)
    np.testing.assert_allclose(reference.output[0], START, rtol=0, atol=1e-13)
    with pytest.raises(UnreachablePosture, match="no height fits"):
        refer(posture_command=(0.2, 0.2, 0.47)).run(0.1)


@pytest.mark.parametrize("end", [0, 1])
def test_the_named_heights_are_those_that_the_heights_of_the_feet_leave(refer, end):
    height = height_range(GEOMETRY, (0.0, 0.0), GROUND, OFFSETS)[end]
    command = np.array((0.0, 0.0, height))
    refer(posture_command=command).run(9.0).assert_rests_at(command)
    # With all feet higher or lower the same posture is out of reach.
    offsets = OFFSETS + (0.001, -0.001)[end]
    with pytest.raises(UnreachablePosture):
        refer(posture_command=command, foot_offsets=offsets).run(0.1)


@pytest.mark.parametrize("command", [(0.0, 0.0, 0.7), (0.0, 0.0, 0.3), (0.3, -0.3, 0.47)])
def test_a_clamped_command_gives_way_in_height_and_then_in_its_angles(refer, command):
    reference = refer("clamp", posture_command=command)
    _, postures, rates = reference.record(20.0, step=0.05)
    inverse_kinematics(GEOMETRY, postures, GROUND, OFFSETS)  # raises where one is out of reach
    end = postures[-1]
    low, high = height_range(GEOMETRY, end[:2], GROUND, OFFSETS)
    assert end[2] == pytest.approx(np.clip(command[2], low, high), abs=1e-12)
    np.testing.assert_allclose(rates[-1], 0.0, atol=1e-12)

    low, high = height_range(GEOMETRY, command[:2], GROUND, OFFSETS)
    if low <= high:
        np.testing.assert_allclose(end[:2], command[:2], rtol=0, atol=1e-12)
        return
    way = np.array(command[:2]) - START[:2]
    share = np.dot(end[:2] - START[:2], way) / np.dot(way, way)
    np.testing.assert_allclose(end[:2], START[:2] + share * way, rtol=0, atol=1e-12)
    low, high = height_range(GEOMETRY, START[:2] + (share + 1.0 / 128.0) * way, GROUND, OFFSETS)
    assert low > high


def test_a_clamped_command_is_the_same_wherever_it_comes_from(refer):
    high = (0.0, 0.0, 0.57)
    direct = refer("clamp", posture_command=high).run(20.0).output[0]
    detour = refer("clamp", posture_command=(0.1, 0.1, 0.39)).run(10.0)
    detour.set(posture_command=high).run(30.0).assert_rests_at(direct)
    np.testing.assert_allclose(direct[:2], 0.0, atol=1e-12)
    refer("clamp").run(6.0).assert_rests_at(COMMAND)


def test_ground_that_changes_is_planned_for_anew(refer):
    reference = refer(posture_command=(0.0, 0.0, 0.5)).run(0.5)
    with pytest.raises(UnreachablePosture, match="no height fits"):
        reference.set(ground=np.radians((5.0, 5.0))).run(0.6)


def test_unknown_treatment_of_unreachable_commands_is_refused():
    with pytest.raises(ValueError, match="on_unreachable"):
        PostureReference(GEOMETRY, on_unreachable="stop")


@pytest.mark.parametrize(
    ("command", "other", "instant"),
    [
        ((0.095, -0.019, 0.7), (-0.114, 0.042, 0.7), 3.24),
        ((0.046, -0.077, 0.7), (-0.119, -0.057, 0.3), 1.65),
        ((0.113, 0.066, 0.3), (0.062, 0.023, 0.7), 3.24),
    ],
)
def test_where_the_way_to_a_new_command_would_leave_the_stroke_it_brakes_first(
    refer, command, other, instant
):
    reference = refer("clamp", posture_command=command).run(instant)
    reference.set(posture_command=other).run(instant + PERIOD)
    began, rate = reference.at(instant)
    ended, standing = reference.at(instant + 0.3)
    # On, by the way that braking evenly for .3 s takes, and to rest.
    np.testing.assert_allclose(ended - began, 0.15 * rate, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(standing, 0.0, atol=1e-12)
    assert np.abs(rate).max() > 1e-3
    # Nothing new is planned meanwhile; then it goes on, inside all the way.
    before = reference.run(instant + 0.2).output[0]
    np.testing.assert_array_equal(before, reference.at(instant + 0.2)[0])
    _, postures, rates = reference.record(instant + 20.0, step=0.05)
    inverse_kinematics(GEOMETRY, postures, GROUND, OFFSETS)  # raises where one is out of reach
    assert (postures[-1] - ended) @ (np.array(other) - ended) > 0.0
    np.testing.assert_allclose(rates[-1], 0.0, atol=1e-12)
