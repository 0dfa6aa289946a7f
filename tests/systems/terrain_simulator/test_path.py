import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from parapod.systems.core.errors import ParapodError
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import (
    LIMITS,
    inverse_kinematics,
    margins,
    singularity,
    slider_accelerations,
    slider_places,
    slider_rates,
)
from parapod.systems.terrain_simulator.path import (
    Gait,
    PathLimits,
    PathRefused,
    PlatePath,
    check_path,
)
from parapod.systems.terrain_simulator.terrain import (
    AlternatingSlopes,
    Heave,
    Level,
    RecordedProfile,
    Rough,
    Slope,
    Stairs,
    Step,
    Terrain,
)

PEDAL, TREADMILL = BenchGeometry.pedal(), BenchGeometry.treadmill()
RECORD = RecordedProfile(
    tuple(0.1 * n for n in range(80)), tuple(0.03 * math.sin(0.5 * n**1.3) for n in range(80))
)
TERRAINS = {
    "level": Level(),
    "slope": Slope(0.3),
    "step": Step(0.12, 1.0),
    "stairs": Stairs(-0.17, 0.29, at=0.7, count=4),
    "alternating slopes": AlternatingSlopes(0.3, 0.45),
    "heave": Heave(0.03, 1.7),
    "rough": Rough(0.02, 0.4, seed=3),
    "recorded": RECORD,
}
PATHS = {
    f"{name}, {kind}": PlatePath(
        terrain, Gait(0.8, 2.0, 0.45, ramp), 0.5, 0.26, dip, phase, 0.1, treadmill
    )
    for name, terrain in TERRAINS.items()
    for kind, ramp, dip, phase, treadmill in (
        ("quintic", None, 0.0, 0.0, False),
        ("ramps", 0.3, 0.02, 0.3, False),
        ("treadmill", None, 0.01, -0.6, True),
    )
}
EACH = pytest.mark.parametrize("path", PATHS.values(), ids=PATHS)
PEDALS = [path for path in PATHS.values() if not path.treadmill]
TREADMILLS = [path for path in PATHS.values() if path.treadmill]


def borders(path, strides=8):
    """Touchdowns and lift-offs [s]."""
    at = np.add.outer(np.arange(1.0, strides), (0.0, path.gait.duty)).ravel()
    return (at - path.phase) / path.gait.frequency


def inside(path, strides=8, samples=40):
    """Times [s] in stances and in swings, away from the borders."""
    duty, near = path.gait.duty, 1e-3
    shares = [np.linspace(a + near, b - near, samples) for a, b in ((0.0, duty), (duty, 1.0))]
    every = np.add.outer(np.arange(strides), np.concatenate(shares)).ravel()
    return (every - path.phase) / path.gait.frequency


# The motion


@EACH
def test_derivatives_agree_with_differences(path):
    at, eps = inside(path), 1e-5
    # The law with ramps and the body's spline have jumps in their third derivatives.
    now, ahead, behind = path.at(at), path.at(at + eps), path.at(at - eps)
    differences = (ahead.pose - behind.pose) / (2.0 * eps)
    np.testing.assert_allclose(now.velocity, differences, rtol=0, atol=1e-5)
    differences = (ahead.velocity - behind.velocity) / (2.0 * eps)
    np.testing.assert_allclose(now.acceleration, differences, rtol=0, atol=3e-2)


@EACH
def test_nothing_jumps_between_stance_and_swing_and_between_strides(path):
    at, eps = borders(path), 1e-9
    before, after = path.at(at - eps), path.at(at + eps)
    assert (before.stance != after.stance).all()
    np.testing.assert_allclose(before.pose, after.pose, rtol=0, atol=2e-8)
    np.testing.assert_allclose(before.velocity, after.velocity, rtol=0, atol=1e-6)
    np.testing.assert_allclose(before.acceleration, after.acceleration, rtol=0, atol=2e-4)
    np.testing.assert_allclose(before.belt, after.belt, rtol=0, atol=1e-8)


@EACH
def test_batches_give_what_single_times_give(path):
    at = np.random.default_rng(0).uniform(-1.0, 4.0, (3, 4))
    whole, single = path.at(at), [path.at(float(t)) for t in at.ravel()]
    assert whole.pose.shape == (3, 4, 3)
    assert whole.belt.shape == whole.stance.shape == (3, 4)
    for name in whole._fields:
        values = getattr(whole, name)
        one = np.reshape([getattr(motion, name) for motion in single], values.shape)
        np.testing.assert_allclose(values, one, rtol=0, atol=1e-11)


@pytest.mark.parametrize("path", PEDALS)
def test_in_stance_the_pedal_moves_back_at_the_speed_of_the_body(path):
    motion, gait = path.at(inside(path)), path.gait
    stands = motion.stance
    assert np.mean(stands) == 0.5
    np.testing.assert_allclose(motion.velocity[stands, 0], -gait.speed, rtol=1e-15)
    np.testing.assert_array_equal(motion.velocity[stands, 2], 0.0)
    touchdown = path.at(borders(path)[::2] + 1e-12).pose[:, 0]
    np.testing.assert_allclose(touchdown, path.x_c + 0.5 * gait.stance, atol=1e-10)


@pytest.mark.parametrize("path", TREADMILLS)
def test_in_stance_the_belt_carries_the_foot_back_at_the_speed_of_the_body(path):
    """The foot is at rest in the world, which moves back and down under the body."""
    gait, strides = path.gait, np.arange(8)
    at = (np.add.outer(strides, gait.duty * np.linspace(0.01, 0.99, 30)) - path.phase) / (
        gait.frequency
    )
    motion = path.at(at)
    assert motion.stance.all()
    x, z, phi = np.moveaxis(motion.pose, -1, 0)
    np.testing.assert_array_equal(x, path.x_c)
    # The belt's way from the stance's middle, and the foot there.
    middle = (strides + 0.5 * gait.duty - path.phase) / gait.frequency
    way = motion.belt * (at - middle[:, np.newaxis])
    foot_x, foot_z = x - way * np.cos(phi), z + way * np.sin(phi)
    np.testing.assert_allclose(
        foot_x, path.x_c - gait.speed * (at - middle[:, np.newaxis]), atol=1e-13
    )
    as_pedal = replace(path, treadmill=False).at(at)
    np.testing.assert_allclose(foot_z, as_pedal.pose[..., 1], rtol=0, atol=1e-13)


@EACH
def test_the_plate_has_the_slope_and_the_height_of_its_foothold(path):
    strides = np.arange(8)
    middle = (strides + 0.5 * path.gait.duty - path.phase) / path.gait.frequency
    motion, at = path.at(middle), path.footholds(strides)
    # The hip is over the foothold in the middle of the stance.
    np.testing.assert_allclose(at, path.start + path.gait.speed * middle, atol=1e-13)
    np.testing.assert_allclose(motion.pose[:, 2], -path.terrain.slope(at), atol=1e-13)
    near = path.terrain.height(path.footholds(np.add.outer(strides, (-1, 0, 1))))
    body = near @ (1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0)
    height = path.z_c + near[:, 1] - body + path.terrain.lift(middle).height
    np.testing.assert_allclose(motion.pose[:, 1], height, atol=1e-13)


@pytest.mark.parametrize("path", PEDALS)
def test_what_the_foothold_rises_the_body_rises_too(path):
    """Far behind a step or a flight of stairs nothing is left of it."""
    if isinstance(path.terrain, Step | Stairs):
        far = replace(path, start=50.0)
        level = replace(path, terrain=Level())
        at = inside(path)
        np.testing.assert_allclose(far.at(at).pose, level.at(at).pose, rtol=0, atol=1e-12)


def test_uphill_the_front_end_is_up_and_the_plate_sinks_while_the_foot_stands():
    motion = PlatePath(Slope(0.3), Gait(0.8), 0.5, 0.26).at(np.linspace(0.01, 0.24, 9))
    assert motion.stance.all()
    np.testing.assert_allclose(motion.pose[:, 2], -0.3)
    np.testing.assert_allclose(motion.velocity[:, 1], -0.8 * math.tan(0.3))


@pytest.mark.parametrize("ramp", [None, 0.2])
@pytest.mark.parametrize("treadmill", [False, True])
def test_downhill_is_uphill_upside_down(ramp, treadmill):
    at = np.linspace(0.0, 3.0, 400)
    pairs = ((Slope(0.3), Slope(-0.3)), (Stairs(0.1, 0.3), Stairs(-0.1, 0.3)))
    for pair in pairs:
        up, down = (
            PlatePath(terrain, Gait(0.8, ramp=ramp), 0.5, 0.0, treadmill=treadmill).at(at)
            for terrain in pair
        )
        for one, other in zip(up[:3], down[:3], strict=True):
            np.testing.assert_allclose(one, other * (1.0, -1.0, -1.0), rtol=0, atol=1e-11)
        np.testing.assert_allclose(up.belt, down.belt)


def test_on_a_slope_a_treadmill_only_runs():
    motion = PlatePath(Slope(0.2), Gait(1.5), 0.88, 0.2, treadmill=True).at(np.linspace(0, 2, 99))
    np.testing.assert_allclose(motion.pose, np.tile((0.88, 0.2, -0.2), (99, 1)), atol=1e-12)
    np.testing.assert_allclose(motion.velocity, 0.0, atol=1e-12)
    np.testing.assert_allclose(motion.belt, 1.5 / math.cos(0.2))


def test_a_dip_is_deepest_in_the_middle_of_the_swing_and_nowhere_in_stance():
    flat = PlatePath(Level(), Gait(0.8, duty=0.5), 0.5, 0.26)
    at = np.linspace(0.0, 0.5, 401)
    dipped = replace(flat, dip=0.03).at(at).pose[:, 1] - 0.26
    np.testing.assert_array_equal(dipped[at < 0.25], 0.0)
    assert dipped.min() == pytest.approx(-0.03)
    assert at[dipped.argmin()] == pytest.approx(0.375)


@pytest.mark.parametrize(
    ("ramp", "duty", "reach", "acceleration"),
    [
        (None, 0.5, 0.597, 23.1), (None, 0.35, 0.497, 13.7), (0.3, 0.5, 0.576, 28.6),
        (0.3, 0.35, 0.465, 16.9), (0.2, 0.5, 0.555, 37.5), (0.2, 0.35, 0.433, 22.2),
    ],
)  # fmt: skip
def test_reach_peak_speed_and_peak_acceleration_of_a_pedal_on_level_ground(
    ramp, duty, reach, acceleration
):
    """Reach by stride and acceleration by v f: computed by hand from the law."""
    gait = Gait(0.9, 1.7, duty, ramp)
    motion = PlatePath(Level(), gait, 0.5, 0.26).at(np.linspace(0.0, 1.0 / 1.7, 20001))
    assert np.ptp(motion.pose[:, 0]) / gait.stride == pytest.approx(reach, abs=6e-4)
    top = 1.875 if ramp is None else 1.0 / (1.0 - ramp)
    assert gait.return_speed == pytest.approx(0.9 * (top / (1.0 - duty) - 1.0))
    assert motion.velocity[:, 0].max() == pytest.approx(gait.return_speed, rel=1e-6)
    found = motion.acceleration[:, 0].max() / (0.9 * 1.7)
    assert found == pytest.approx(acceleration, abs=0.06)


@EACH
def test_accelerations_of_the_sliders_are_the_rates_of_their_speeds(path):
    at, eps = inside(path), 1e-5
    geometry = TREADMILL if path.treadmill else PEDAL
    path = replace(path, x_c=0.88, z_c=0.2) if path.treadmill else path
    ahead, behind = (path.at(at + step) for step in (eps, -eps))
    speeds = [slider_rates(geometry, m.pose, m.velocity) for m in (ahead, behind)]
    places = [slider_places(geometry, m.pose) for m in (ahead, behind)]
    now = path.at(at)
    near = np.isfinite(places[0]).all(axis=-1) & (margins(geometry, now.pose)[:, 5] > 0.0)
    assert near.mean() > 0.5
    found = slider_accelerations(geometry, *now[:3])
    differences = (speeds[0] - speeds[1]) / (2.0 * eps)
    np.testing.assert_allclose(found[near], differences[near], rtol=1e-4, atol=0.1)
    differences = (places[0] - places[1]) / (2.0 * eps)
    rates = slider_rates(geometry, now.pose, now.velocity)
    np.testing.assert_allclose(rates[near], differences[near], rtol=1e-5, atol=1e-4)


# What is feasible


class Set(NamedTuple):
    terrain: object
    gait: Gait
    x_c: float
    z_c: float
    slider_speed: float
    slider_acceleration: float
    start: float = 0.0
    dip: float = 0.0

    @property
    def path(self):
        return PlatePath(self.terrain, self.gait, self.x_c, self.z_c, self.dip, start=self.start)


SLOPE = math.radians(20.0)
# Largest slider speeds [m/s] and accelerations [m/s^2] of a computation of its own: one stride of
# a ground that repeats, on which the body rises at one speed. Stairs begin far behind.
FEASIBLE = {
    "slow walk": Set(Level(), Gait(0.5, 1.0, 0.6), 0.513, 0.30, 1.84, 18),
    "walk": Set(Level(), Gait(1.0), 0.513, 0.30, 2.75, 46),
    "walking trot": Set(Level(), Gait(1.5, ramp=0.28), 0.513, 0.30, 2.67, 89),
    "flying trot": Set(Level(), Gait(2.75, 2.0, 0.30, 0.2), 0.50, 0.33, 2.75, 105),
    "slope +20": Set(Slope(SLOPE), Gait(0.8), 0.562, 0.26, 2.99, 57),
    "slope -20": Set(Slope(-SLOPE), Gait(0.8), 0.474, 0.26, 3.08, 60),
    "slope +30": Set(Slope(1.5 * SLOPE), Gait(0.8), 0.582, 0.24, 3.30, 71),
    "slope -30": Set(Slope(-1.5 * SLOPE), Gait(0.8), 0.458, 0.24, 3.49, 82),
    "slope +45": Set(Slope(0.25 * math.pi), Gait(0.2, 1.0), 0.580, 0.26, 1.17, 14),
    "steps up": Set(Stairs(0.12, 0.4), Gait(0.6, 1.5), 0.549, 0.25, 2.10, 29, 4.0),
    "steps up, dip": Set(Stairs(0.12, 0.4), Gait(0.6, 1.5), 0.549, 0.25, 2.05, 32, 4.0, 0.03),
    "steps down": Set(Stairs(-0.12, 0.4), Gait(0.6, 1.5), 0.489, 0.25, 2.10, 29, 4.0),
    "stairs up": Set(Stairs(0.17, 0.29), Gait(0.435, 1.5), 0.561, 0.25, 1.85, 28, 2.9),
    "stairs, slow": Set(Stairs(0.17, 0.29), Gait(0.29, 1.0, 0.6), 0.561, 0.25, 1.66, 20, 2.9),
    "stairs down": Set(Stairs(-0.15, 0.30), Gait(0.45, 1.5), 0.481, 0.25, 1.81, 26, 3.0),
    "two steps": Set(Stairs(0.17, 0.29), Gait(0.58, 1.0), 0.589, 0.22, 2.33, 29, 2.9),
    "alternating 20": Set(
        AlternatingSlopes(SLOPE, 0.4), Gait(0.8), 0.513, 0.27, 2.55, 42, 0.1
    ),
    "alternating 40": Set(
        AlternatingSlopes(2 * SLOPE, 0.4), Gait(0.8), 0.513, 0.27, 2.90, 47, 0.1
    ),
    "heave": Set(Heave(0.05, 3.0), Gait(0.0), 0.513, 0.26, 1.04, 31),
}  # fmt: skip
SETS = pytest.mark.parametrize("name", FEASIBLE)


def largest(geometry, path, strides=10):
    motion = path.at(np.linspace(0.0, strides / path.gait.frequency, 20001))
    speeds = slider_rates(geometry, motion.pose, motion.velocity)
    return np.abs(speeds).max(), np.abs(slider_accelerations(geometry, *motion[:3])).max()


def refusal(path):
    try:
        check_path(PEDAL, path)
    except PathRefused as error:
        return error
    return None


@SETS
def test_sets_that_are_feasible_are_accepted_with_their_slider_speeds(name):
    check_path(PEDAL, FEASIBLE[name].path)
    speed, acceleration = largest(PEDAL, FEASIBLE[name].path)
    assert speed == pytest.approx(FEASIBLE[name].slider_speed, rel=0.02)
    assert acceleration == pytest.approx(FEASIBLE[name].slider_acceleration, abs=0.6)


@SETS
def test_one_percent_less_than_what_the_sliders_do_is_refused(name):
    path = FEASIBLE[name].path
    for limit, most in zip(("speed", "acceleration"), largest(PEDAL, path), strict=True):
        for share in (1.001, 0.99):
            limits = PathLimits(**{f"slider_{limit}": share * most})
            if share > 1.0:
                check_path(PEDAL, path, limits)
                continue
            with pytest.raises(PathRefused, match=f"^{limit} of slider") as refused:
                check_path(PEDAL, path, limits)
            assert refused.value.worst == pytest.approx(most, rel=1e-3)


def test_a_walking_trot_with_a_quintic_is_refused_for_the_speed_of_its_return():
    path = PlatePath(Level(), Gait(1.5), 0.513, 0.30)
    with pytest.raises(PathRefused) as refused:
        check_path(PEDAL, path)
    error = refused.value
    assert error.limit == "horizontal speed of the plate"
    assert error.worst == pytest.approx(4.125)
    # A quintic meets 2.75 m/s when v (1.875 * 2 - 1) does.
    assert error.admissible == pytest.approx(1.0, rel=1e-3)
    assert str(error) == (
        "horizontal speed of the plate: 4.125 m/s is more than 2.75 m/s, first at "
        f"{error.instant:.3f} s; the largest admissible speed is {error.admissible:.4g} m/s"
    )
    at = np.array((error.instant - 0.003, error.instant))
    before, after = np.abs(path.at(at).velocity[:, 0])
    assert before < 2.75 < after


def test_limits_that_are_met_exactly_are_kept():
    check_path(PEDAL, PlatePath(Level(), Gait(1.0), 0.513, 0.30))
    assert Gait(1.0).return_speed == 2.75


def test_heave_that_is_too_quick_has_no_admissible_speed():
    path = PlatePath(Heave(0.08, 4.0), Gait(0.0), 0.513, 0.26)
    with pytest.raises(PathRefused, match=r"^acceleration of slider 1.* no speed is admissible"):
        check_path(PEDAL, path)


def test_a_slope_that_the_plate_cannot_take_has_no_admissible_speed():
    path = PlatePath(Slope(-0.9), Gait(0.5), 0.5, 0.2)
    with pytest.raises(PathRefused, match=r"^line P T A_3: sin mu comes to") as refused:
        check_path(PEDAL, path)
    assert refused.value.admissible is None
    assert str(refused.value).endswith("; no speed is admissible")


@pytest.mark.parametrize(
    ("change", "limit"),
    [
        ({"x_c": 0.36}, "rear end of slider 1"),
        ({"x_c": 0.67}, "front end of slider 3"),
        ({"z_c": 0.05}, "height of P"),
        ({"z_c": 0.36}, "reach of P"),
        ({"z_c": 0.345}, "gap of A_1 and A_2"),
    ],
)
def test_places_beyond_the_mechanism_are_refused_by_their_limit(change, limit):
    path = replace(PlatePath(Level(), Gait(0.9), 0.513, 0.30), **change)
    with pytest.raises(PathRefused, match=f"^{limit}: .* mm are missing") as refused:
        check_path(PEDAL, path)
    error = refused.value
    pose = path.at(error.instant).pose
    assert margins(PEDAL, pose)[LIMITS.index(limit)] < 0.0
    assert error.worst < 0.0
    with pytest.raises(ParapodError):
        inverse_kinematics(PEDAL, pose)


def test_the_belt_must_be_as_long_as_the_stance():
    """2 m/s at 2 Hz and duty 0.5 take 0.5 m; 2.75 m/s take 0.6875 m of the 0.6 m."""
    path = PlatePath(Level(), Gait(2.0), 0.88, 0.2, treadmill=True)
    check_path(TREADMILL, path)
    with pytest.raises(PathRefused, match=r"^length of the belt: 0\.6875 m") as refused:
        check_path(TREADMILL, path.at_speed(2.75))
    assert refused.value.admissible == pytest.approx(2.4, rel=1e-3)
    check_path(TREADMILL, replace(path, gait=Gait(2.75, duty=0.436)))


def test_on_a_slope_the_stance_takes_more_of_the_belt():
    path = PlatePath(Slope(-0.2), Gait(2.4), 0.88, 0.2, treadmill=True)
    with pytest.raises(PathRefused, match=r"^length of the belt") as refused:
        check_path(TREADMILL, path)
    assert refused.value.worst == pytest.approx(0.6 / math.cos(0.2))
    assert refused.value.admissible == pytest.approx(2.4 * math.cos(0.2), rel=1e-3)


class Hole(Terrain):
    def height(self, distance):
        return np.where(np.abs(np.asarray(distance) - 1.1135) < 0.0035, -5.0, 0.0)


def test_a_speed_is_not_named_if_a_little_slower_a_foot_falls_into_a_hole():
    """At 0.99 m/s the third foothold is at 0.99 * 1.125 m = 1.114 m; at 1 m/s it is not."""
    path = PlatePath(Hole(), Gait(1.5), 0.513, 0.30)
    check_path(PEDAL, path.at_speed(1.0))
    assert refusal(path.at_speed(0.99)) is not None
    assert refusal(path).admissible == pytest.approx(1.11 / 1.125, rel=1e-3)


def test_a_step_ahead_is_refused_only_if_the_way_leads_there():
    path = PlatePath(Step(0.5, 3.0), Gait(0.6, 1.5), 0.513, 0.25)
    check_path(PEDAL, path, duration=2.0)
    with pytest.raises(PathRefused) as refused:
        check_path(PEDAL, path, duration=6.0)
    # No speed leads over it: a slower one has the same way.
    assert refused.value.admissible is None


def random_paths(count=40):
    random = np.random.default_rng(7)
    for n in range(count):
        angle, rise = random.uniform(-0.35, 0.35), random.uniform(-0.12, 0.12)
        terrain = (
            Level(),
            Slope(angle),
            Step(rise, random.uniform(0.2, 2.0)),
            Stairs(rise, random.uniform(0.25, 0.4), count=int(random.integers(1, 9))),
            AlternatingSlopes(angle, random.uniform(0.3, 1.0)),
            Heave(random.uniform(0.0, 0.03), random.uniform(0.5, 3.0)),
            Rough(random.uniform(0.0, 0.015), random.uniform(0.8, 2.0), seed=n, shortest=0.5),
        )[n % 7]
        gait = Gait(
            random.uniform(0.2, 2.5),
            random.uniform(1.0, 2.5),
            random.uniform(0.3, 0.6),
            random.choice((None, 0.25)),
        )
        yield PlatePath(terrain, gait, random.uniform(0.49, 0.54), random.uniform(0.24, 0.28))


def test_paths_are_accepted_or_refused_with_a_speed_that_is_accepted(work_of):
    """Accepted: on other samples too, whatever the sampling."""
    accepted = 0
    for path in random_paths():
        duration = 10.0 / path.gait.frequency
        with work_of() as work:
            error = refusal(path)
        assert work.calls < 60_000
        if error is None:
            accepted += 1
        else:
            assert "\n" not in str(error)
            assert 0.0 <= error.instant <= duration
            assert 0.0 < error.admissible < path.gait.speed
            slower = path.at_speed(0.99 * error.admissible)
            for accepted_too in (path.at_speed(error.admissible), slower):
                check_path(PEDAL, accepted_too)
            # Over the same way too.
            check_path(PEDAL, slower, duration=duration * path.gait.speed / slower.gait.speed)
            path = slower
        motion = path.at(np.random.default_rng(0).uniform(0.0, duration, 5000))
        assert margins(PEDAL, motion.pose).min() > -1e-5
        assert singularity(PEDAL, motion.pose).sin_mu.min() > 0.25 - 1e-4
        rates = slider_rates(PEDAL, motion.pose, motion.velocity)
        assert np.abs(rates).max() < 3.5 * 1.002
        assert np.abs(slider_accelerations(PEDAL, *motion[:3])).max() < 110.0 * 1.01
        assert (np.abs(motion.velocity) < 1.002 * np.array((2.75, 2.5, 5 * math.pi))).all()
    assert 5 < accepted < 35


def test_a_check_is_cheap(work_of):
    path = PlatePath(Rough(0.01, 1.0, shortest=0.5), Gait(0.5), 0.513, 0.26)
    check_path(PEDAL, path)
    with work_of() as work:
        check_path(PEDAL, path)
    assert work.calls < 3_000


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Gait(-0.1), "speed must not be negative"),
        (lambda: Gait(math.nan), "speed must not be negative"),
        (lambda: Gait(1.0, frequency=0.0), "frequency must be positive"),
        (lambda: Gait(1.0, duty=1.0), "duty must be between 0 and 1"),
        (lambda: Gait(1.0, ramp=0.6), "ramp must be in"),
        (lambda: PlatePath(Level(), Gait(1.0), math.nan, 0.3), "x_c must be finite"),
        (lambda: PlatePath(Level(), Gait(1.0), 0.5, 0.3, dip=-0.1), "dip must not be negative"),
        (lambda: PathLimits(slider_speed=0.0), "slider_speed must be positive"),
        (lambda: PATHS["level, quintic"].at((0.0, math.nan)), "times must be finite"),
        (lambda: check_path(PEDAL, PEDALS[0], duration=0.0), "duration must be positive"),
    ],
)
def test_numbers_that_make_no_path_are_refused_by_name(make, words):
    with pytest.raises(ValueError, match=words):
        make()
