import math
from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import margins
from parapod.systems.terrain_simulator.workspace import rail_interval, workspace

PEDAL, TREADMILL = BenchGeometry.pedal(), BenchGeometry.treadmill()
# Least sine of the transmission angle that is recommended.
GUARDED = 0.25
BOTH = {"pedal": (PEDAL, 45.0), "treadmill": (TREADMILL, 14.0)}


def common(name, least_sin_mu=GUARDED):
    """Places that can be reached at all angles of a bench's range."""
    geometry, most = BOTH[name]
    return workspace(geometry, np.radians(np.arange(-most, most + 0.25, 0.5)), least_sin_mu)


def test_an_interval_is_where_no_limit_is_broken(geometry):
    rng = np.random.default_rng(0)
    tilt = 0.8 if geometry.strut_ahead else 0.25
    pose = rng.uniform((0.0, 0.0, -tilt), (1.3, 0.4, tilt), (40_000, 3))
    ends = rail_interval(geometry, pose[:, 1], pose[:, 2], GUARDED)
    left = margins(geometry, pose)
    left[:, 4] -= GUARDED
    inside = (ends[:, 0] <= pose[:, 0]) & (pose[:, 0] <= ends[:, 1])
    assert np.array_equal(inside, (left >= 0.0).all(axis=-1))
    assert 0.1 < inside.mean() < 0.5
    # Without a distance from the singularity there is more.
    up_to_it = rail_interval(geometry, pose[:, 1], pose[:, 2])
    assert (~np.isnan(up_to_it[:, 0])).sum() > 1.02 * (~np.isnan(ends[:, 0])).sum()


@pytest.mark.parametrize(
    ("geometry", "degrees", "area", "z", "x", "width", "guarded"),
    [
        (PEDAL, -45.0, 0.1276, (0.0656, 0.3414), (0.106, 0.907), 0.801, 0.1276),
        (PEDAL, 0.0, 0.1040, (0.0690, 0.3448), (0.146, 0.820), 0.675, 0.1040),
        (PEDAL, 45.0, 0.0704, (0.1298, 0.3195), (0.176, 0.762), 0.586, 0.0402),
        (TREADMILL, -14.0, 0.1362, (0.0926, 0.3684), (0.421, 1.158), 0.534, 0.1141),
        (TREADMILL, 0.0, 0.1512, (0.0200, 0.2958), (0.430, 1.214), 0.729, 0.1089),
        (TREADMILL, 14.0, 0.0871, (0.0926, 0.2232), (0.421, 1.264), 0.832, 0.0871),
    ],
)
def test_areas_and_extents_at_one_angle(geometry, degrees, area, z, x, width, guarded):
    found = workspace(geometry, math.radians(degrees))
    assert found.area == pytest.approx(area, abs=6e-5)
    assert (found.z_min, found.z_max) == pytest.approx(z, abs=6e-5)
    assert found.extent[:2] == pytest.approx(x, abs=6e-4)
    assert found.width == pytest.approx(width, abs=6e-4)
    assert workspace(geometry, math.radians(degrees), GUARDED).area == pytest.approx(
        guarded, abs=6e-5
    )


def test_the_error_of_an_area_falls_with_the_square_of_the_cells():
    exact = workspace(PEDAL, 0.0, cells=64_000).area
    errors = [abs(workspace(PEDAL, 0.0, cells=n).area - exact) for n in (50, 100, 200)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.3)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.3)


@pytest.mark.parametrize("name", BOTH)
def test_the_specified_box_fits_at_no_angle(name):
    geometry, most = BOTH[name]
    for degrees in np.linspace(-most, most, 7):
        box = workspace(geometry, math.radians(degrees)).widest_box(0.2)
        assert box is None or box.width < 0.5
    assert common(name, 0.0).widest_box(0.2) is None


@pytest.mark.parametrize(
    ("name", "widths"),
    [("pedal", (0.535, 0.481, 0.417, 0.367)), ("treadmill", (0.521, 0.500, 0.475, 0.457))],
)
def test_boxes_that_hold_for_the_whole_range_of_angles(name, widths):
    space = common(name)
    geometry, most = BOTH[name]
    for height, width in zip((0.0, 0.02, 0.05, 0.08), widths, strict=True):
        box = space.widest_box(height)
        assert box.width == pytest.approx(width, abs=1.2e-3)
        assert box.height == pytest.approx(height, abs=1e-12)
        # Its corners can be reached at every angle.
        for degrees in np.linspace(-most, most, 9):
            for x in box[:2]:
                for z in box[2:]:
                    left = margins(geometry, (x, z, math.radians(degrees)))
                    left[4] -= GUARDED
                    assert left.min() > -1e-4


def test_a_box_as_high_as_the_workspace_is_its_narrowest_part():
    space = workspace(PEDAL, math.radians(-45.0))
    tall = space.z_max - space.z_min
    narrowest = space.ends[:, 1].min() - space.ends[:, 0].max()
    assert space.widest_box(0.999 * tall).width == pytest.approx(narrowest, abs=1e-3)
    assert space.widest_box(1.001 * tall) is None


def test_the_tallest_box_of_half_a_metre_is_a_strip():
    box = common("pedal").tallest_box(0.5)
    assert box.width >= 0.5
    assert box.height == pytest.approx(0.0125, abs=5e-4)
    assert common("pedal").tallest_box(0.6) is None
    assert workspace(PEDAL, math.radians(-45.0)).tallest_box(0.5).height == pytest.approx(
        0.0915, abs=1e-4
    )


def test_the_other_branch_and_one_rail_leave_a_treadmill_next_to_nothing():
    ahead, one_rail = replace(TREADMILL, strut_ahead=True), replace(TREADMILL, strut_gap=0.1)
    steep = math.radians(14.0)
    assert workspace(ahead, steep).is_empty
    assert workspace(ahead, 0.0).area == pytest.approx(0.0002, abs=5e-5)
    areas = [workspace(one_rail, angle).area for angle in (-steep, 0.0, steep)]
    assert areas == pytest.approx((0.0416, 0.0201, 0.0012), abs=6e-5)
    strip = workspace(one_rail, steep)
    assert strip.z_max - strip.z_min == pytest.approx(1.4e-3, abs=1e-4)
    assert workspace(one_rail, (-steep, steep)).is_empty


def test_33_degrees_are_the_largest_offset_with_which_no_strut_comes_too_near():
    def nearest(degrees):
        bench = replace(PEDAL, offset=math.radians(degrees), strut_gap=None)
        space = workspace(bench, math.radians(-45.0))
        pose = np.stack([np.full_like(space.z, v) for v in (0.0, 0.0, -math.pi / 4.0)], axis=-1)
        pose[:, 1] = space.z
        shared = replace(bench, strut_gap=0.1)
        return 0.1 + margins(shared, pose)[:, 6].min()

    assert [nearest(degrees) for degrees in (32, 33, 34)] == pytest.approx(
        (0.10216, 0.10026, 0.09838), abs=1e-5
    )


def test_an_empty_workspace_has_no_boxes():
    nothing = workspace(PEDAL, math.radians(120.0))
    assert nothing.is_empty
    assert nothing.area == nothing.width == 0.0
    assert nothing.widest_box(0.0) is None
    assert nothing.tallest_box(0.1) is None
    assert np.isnan(nothing.extent).all()


@pytest.mark.parametrize("angle", [math.nan, []])
def test_angles_that_are_none_are_refused(angle):
    with pytest.raises(ValueError, match="phi must be finite angles"):
        workspace(PEDAL, angle)
