import math

import numpy as np
import pytest

from parapod.systems.core.errors import ScenarioError
from parapod.systems.terrain_simulator.terrain import (
    TERRAINS,
    AlternatingSlopes,
    Heave,
    Level,
    RecordedProfile,
    Rough,
    Slope,
    Stairs,
    Step,
    Terrain,
    read_profile,
)

RECORD = RecordedProfile((0.0, 0.1, 0.25, 0.3), (0.0, 0.02, -0.01, 0.0))
EXAMPLES = (
    Level(),
    Slope(0.3),
    Step(-0.12, 0.4),
    Stairs(0.17, 0.29),
    AlternatingSlopes(0.3, 0.4),
    Heave(0.05, 3.0),
    Rough(0.03, 0.5, seed=4),
    RECORD,
)
EACH = pytest.mark.parametrize("terrain", EXAMPLES, ids=lambda t: type(t).__name__)


def test_every_terrain_has_a_name():
    assert set(TERRAINS.values()) == {type(example) for example in EXAMPLES}
    ours = {kind for kind in Terrain.__subclasses__() if kind.__module__ == Terrain.__module__}
    assert set(TERRAINS.values()) == ours


@EACH
def test_batches_give_what_single_distances_give(terrain):
    batch = np.random.default_rng(0).uniform(-1.0, 3.0, (4, 3))
    for function in (terrain.height, terrain.slope, lambda s: terrain.lift(s).height):
        whole = function(batch)
        assert whole.shape == (4, 3)
        single = [function(float(s)) for s in batch.ravel()]
        np.testing.assert_allclose(whole.ravel(), single, rtol=0, atol=1e-14)


@pytest.mark.parametrize("terrain", [Slope(-0.4), Rough(0.03, 0.5, seed=2)])
def test_slope_is_the_angle_of_the_tangent(terrain):
    at, eps = np.linspace(0.0, 5.0, 101), 1e-6
    rise = (terrain.height(at + eps) - terrain.height(at - eps)) / (2.0 * eps)
    np.testing.assert_allclose(np.tan(terrain.slope(at)), rise, rtol=0, atol=1e-7)


def test_step_is_at_its_edge_and_may_lead_down():
    assert Step(-0.12, 0.4).height((0.39, 0.4, 9.0)).tolist() == [0.0, -0.12, -0.12]


def test_stairs_rise_by_one_step_a_tread_up_to_their_landing():
    middles = 0.29 * (np.arange(-2, 5) + 0.5)
    np.testing.assert_allclose(
        Stairs(0.17, 0.29).height(middles), 0.17 * np.array((0, 0, 1, 2, 3, 4, 5))
    )
    np.testing.assert_allclose(
        Stairs(-0.15, 0.29, count=3).height(middles), -0.15 * np.array((0, 0, 1, 2, 3, 3, 3))
    )


@pytest.mark.parametrize("treads", [1, 2])
def test_strides_at_the_speed_of_stairs_take_as_many_treads(treads):
    stairs = Stairs(0.17, 0.29)
    stride = stairs.speed(1.5, treads) / 1.5
    heights = stairs.height(0.1 + stride * np.arange(8))
    np.testing.assert_allclose(np.diff(heights), treads * 0.17)


def test_alternating_slopes_return_to_their_height_and_do_not_jump():
    ground = AlternatingSlopes(0.3, 0.4)
    at = np.linspace(0.0, 4.0, 4001)
    heights = ground.height(at)
    assert np.abs(np.diff(heights)).max() <= 1e-3 * math.tan(0.3) * (1 + 1e-9)
    np.testing.assert_allclose(ground.height(at + 0.8), heights, atol=1e-12)
    assert ground.height(0.4) == pytest.approx(0.4 * math.tan(0.3))
    assert ground.slope((0.2, 0.6, 1.0)).tolist() == [0.3, -0.3, 0.3]


def test_heave_is_a_motion_of_the_time_alone():
    ground, eps = Heave(0.05, 3.0), 1e-5
    at = np.linspace(0.0, 1.0, 50)
    now, ahead, behind = ground.lift(at), ground.lift(at + eps), ground.lift(at - eps)
    differences = (ahead.height - behind.height) / (2 * eps)
    np.testing.assert_allclose(now.velocity, differences, atol=1e-7)
    differences = (ahead.velocity - behind.velocity) / (2 * eps)
    np.testing.assert_allclose(now.acceleration, differences, atol=1e-5)
    assert ground.lift(1.0 / 12.0).height == pytest.approx(0.05)
    assert not ground.height(at).any()


def test_the_seed_makes_the_ground():
    at = np.linspace(0.0, 10.0, 100)
    one, same, other = (Rough(0.03, 0.5, seed).height(at) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 0.01


def test_rough_ground_has_its_deviation_and_its_correlation():
    """Over 600 correlation lengths of ten grounds."""
    at = np.arange(0.0, 300.0, 0.05)
    deviations, correlations = [], []
    for seed in range(10):
        height = Rough(0.03, 0.5, seed).height(at)
        deviations.append(np.sqrt(np.mean(height**2)))
        correlations.append([np.mean(height[:-n] * height[n:]) for n in (5, 10, 20)])
    assert np.mean(deviations) == pytest.approx(0.03, rel=0.03)
    found = np.mean(correlations, axis=0) / 0.03**2
    np.testing.assert_allclose(found, np.exp((-0.5, -1.0, -2.0)), rtol=0, atol=0.05)


def test_the_spectrum_of_short_waves_falls_by_its_exponent():
    """Between waves of 1.0 m and 0.25 m: four times the wave number."""
    at = np.arange(0.0, 1000.0, 0.05)
    for falloff in (2.0, 3.0):
        power = np.zeros(len(at) // 2 + 1)
        for seed in range(12):
            ground = Rough(0.03, 2.0, seed, falloff)
            power += np.abs(np.fft.rfft(ground.height(at) * np.hanning(len(at)))) ** 2
        numbers = np.fft.rfftfreq(len(at), 0.05)
        bands = [power[(numbers > f / 1.5) & (numbers < f * 1.5)].sum() / f for f in (1.0, 4.0)]
        assert math.log(bands[0] / bands[1]) / math.log(4.0) == pytest.approx(falloff, abs=0.15)


def test_the_longest_and_the_shortest_wave_of_rough_ground_are_as_long_as_they_are_to_be():
    at = np.linspace(0.0, 400.0, 2**15, endpoint=False)
    for longest in (4.0, 20.0):
        ground = Rough(0.03, 0.5, 3, shortest=0.25, longest=longest)
        spectrum = np.abs(np.fft.rfft(ground.height(at) * np.hanning(len(at))))
        waves = np.fft.rfftfreq(len(at), at[1])[spectrum > 1e-3 * spectrum.max()]
        # Each band has a wave anywhere in it, and the window smears each over two lines.
        assert 1.0 / waves.min() == pytest.approx(0.5 * longest, rel=0.15)
        assert 1.0 / waves.max() == pytest.approx(0.25, rel=0.15)


def test_a_record_is_level_beyond_its_ends_and_straight_between():
    assert RECORD.height((-1.0, 0.05, 0.1, 1.0)).tolist() == [0.0, 0.01, 0.02, 0.0]
    assert RECORD.slope(0.05) == pytest.approx(math.atan(0.2))
    assert RECORD.slope((-1.0, 1.0)).tolist() == [0.0, 0.0]


def written(folder, text):
    path = folder / "ground.csv"
    path.write_text(text)
    return path


def test_a_profile_is_read_back(tmp_path):
    path = written(tmp_path, "distance,height\n0,0\n\n0.1,0.02\n0.2,-1e-2\n")
    assert read_profile(path) == RecordedProfile((0.0, 0.1, 0.2), (0.0, 0.02, -0.01))


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("0,0\n0.1,0\n0.1,1\n", "row 4: the distance must increase, but 0.1 m follows 0.1 m"),
        ("0,0\n0.1,0\n0.05,1\n", "row 4: the distance must increase"),
        ("0,0\n0.1,0\n0.4,1\n", "row 4: the gap from 0.1 m to 0.4 m is larger than 0.1 m"),
        ("0,0\n0.1,nan\n", "row 3 must be two finite numbers, not 0.1,nan"),
        ("0,0\ninf,0\n", "row 3 must be two finite numbers"),
        ("0,0\n0.1\n", "row 3 must be two numbers, not 0.1"),
        ("0,0\n0.1,0,0\n", "row 3 must be two numbers"),
        ("0,0\n0.1,high\n", "row 3 must be two numbers, not 0.1,high"),
        ("0,0\n", "at least two rows of numbers, not 1"),
    ],
)
def test_rows_that_are_no_profile_are_refused_with_file_and_row(tmp_path, rows, words):
    path = written(tmp_path, "distance,height\n" + rows)
    with pytest.raises(ScenarioError) as refused:
        read_profile(path)
    assert words in str(refused.value)
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("header", ["", "height,distance\n", "x,z\n", "distance,height,more\n"])
def test_other_columns_are_refused(tmp_path, header):
    with pytest.raises(ScenarioError, match="row 1 must be distance,height, not"):
        read_profile(written(tmp_path, header + "0,0\n0.1,0\n"))


def test_a_file_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(ScenarioError, match="cannot be read"):
        read_profile(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"distance,height\n\xff\xfe\n")
    with pytest.raises(ScenarioError, match="cannot be read"):
        read_profile(tmp_path / "binary.csv")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Slope(math.nan), "angle must be finite"),
        (lambda: Slope(1.6), "angle must be within"),
        (lambda: Step(math.inf), "rise must be finite"),
        (lambda: Stairs(0.1, 0.0), "tread must be positive"),
        (lambda: Stairs(0.1, 0.3, count=0), "count must be a whole number"),
        (lambda: AlternatingSlopes(0.3, -1.0), "length must be positive"),
        (lambda: Heave(0.05, 0.0), "frequency must be positive"),
        (lambda: Rough(-0.1, 0.5), "deviation must not be negative"),
        (lambda: Rough(0.1, 0.5, seed=-1), "seed must be a whole number"),
        (lambda: Rough(0.1, 0.5, shortest=60.0), "shortest = 60 m must be less"),
        (lambda: RecordedProfile((0.0,), (0.0,)), "at least two"),
        (lambda: RecordedProfile((0.0, 0.0), (0.0, 1.0)), "distances must increase"),
        (lambda: RecordedProfile((0.0, 1.0), (0.0, math.nan)), "must be finite"),
        (lambda: RecordedProfile((0.0, 1.0), (0.0, 0.0), foot=0.0), "foot must be positive"),
        (lambda: read_profile("none.csv", largest_gap=0.0), "largest_gap must be positive"),
    ],
)
def test_sizes_that_make_no_ground_are_refused_by_name(make, words):
    with pytest.raises(ValueError, match=words):
        make()
