import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from parapod.systems.machining_centre.branch import (
    branch_forward,
    branch_joints,
    branch_joints_and_rates,
    foot_of_limb,
    turned_foot,
)
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import displacement, leg_lengths, moved

STEP = 1e-6
ALONG = pytest.mark.parametrize("along", ["middle", "left"])


def test_joints_are_at_home_as_the_figure_has_them(geometry):
    joints = branch_joints(geometry, (0.0, 0.0, 0.48, 0.0, 0.0, 0.0))
    expected = (0.0, 0.2238696234, 0.0, 0.4922846289, 0.0, -0.2238696234)
    assert np.allclose(joints, expected, atol=1e-10)


def test_joints_of_a_tilted_pose_are_those_computed_by_another_program():
    expected = (
        (0.0447257583, 0.1543322174, 0.053049844, 0.5103087616, 0.1035884899, -0.1044639368),
        (0.0654942325, 0.2140321353, -0.0491574882, 0.5136154725, -0.1190494273, -0.1962568643),
        (0.0454119589, 0.277090795, 0.0505751562, 0.5154727041, 0.0696279014, -0.345421789),
    )
    joints = branch_joints(CentreGeometry(), (0.03, 0.02, 0.5, 0.05, -0.05, 0.05))
    assert np.allclose(joints, expected, atol=1e-9)


@ALONG
def test_the_chain_leads_back_to_the_pose(geometry, poses, uneven, along):
    batch, feet = poses(500, angle=0.3), uneven(500)
    joints = branch_joints(geometry, batch, feet, along=along)
    back = branch_forward(geometry, joints, feet, along=along)
    assert back.shape == (500, geometry.limbs, 6)
    assert np.abs(back - batch[:, None]).max() < 1e-9


@ALONG
def test_rates_are_the_slopes_of_the_joints(geometry, poses, uneven, along):
    batch, feet = poses(100), uneven(100)
    twist = np.random.default_rng(2).normal(size=(100, 6))
    ahead, behind = (
        branch_joints(geometry, moved(batch, sign * STEP * twist), feet, along=along)
        for sign in (1, -1)
    )
    joints, rates = branch_joints_and_rates(geometry, batch, feet, along=along)
    assert np.array_equal(joints, branch_joints(geometry, batch, feet, along=along))
    slopes = (ahead - behind) / (2.0 * STEP)
    assert np.abs(slopes - np.einsum("knij,kj->kni", rates, twist)).max() < 1e-7


def test_the_chain_along_the_left_leg_has_its_length(geometry, poses):
    batch = poses(10)
    joints = branch_joints(geometry, batch, along="left")
    assert np.allclose(joints[..., 3], leg_lengths(geometry, batch)[..., 0::2], atol=1e-15)
    # Turning about the foot's axis and the hinge is common to both chains.
    shared = [0, 1, 5]
    middle = branch_joints(geometry, batch)
    assert np.allclose(joints[..., shared], middle[..., shared], atol=1e-12)


def test_first_joints_see_translations_as_they_should():
    # dq_1/dp = (u . z_a) (u x l) / |P_xy (u x l)|^2, derived by hand, with l from A to P_C.
    geometry, pose = CentreGeometry(), np.array((0.03, 0.02, 0.5, 0.05, -0.15, 0.05))
    rates = branch_joints_and_rates(geometry, pose)[1][:, 0, 3:]
    R_WP = Rotation.from_euler("xyz", pose[3:]).as_matrix()
    for i in range(3):
        u = R_WP @ (geometry.pivots[2 * i + 1] - geometry.pivots[2 * i])
        u /= np.linalg.norm(u)
        line = pose[:3] + R_WP @ geometry.middles[i] - geometry.footholds[i, :3]
        normal = np.cross(u, line)
        expected = u[2] * normal / (normal[0] ** 2 + normal[1] ** 2)
        assert np.allclose(rates[i], expected, atol=1e-12)


@ALONG
def test_a_loose_foot_is_where_its_locked_joints_and_its_legs_have_it(
    geometry, poses, uneven, along
):
    for pose, feet in zip(poses(20, angle=0.3), uneven(20), strict=True):
        joints = branch_joints(geometry, pose, feet, along=along)
        lengths = leg_lengths(geometry, pose, feet).reshape(-1, 2)
        for limb in range(1, geometry.limbs + 1):
            locked = joints[limb - 1, [0, 1, 2, 5]]
            pair = lengths[limb - 1]
            foot = foot_of_limb(geometry, pose, limb, pair, locked, along=along)
            assert np.abs(displacement(feet[limb - 1], foot)).max() < 1e-12


@ALONG
def test_legs_that_do_not_meet_have_no_foot(geometry, along):
    pose, locked = (0.0, 0.0, 0.48, 0.0, 0.0, 0.0), (0.0, 0.2, 0.0, 0.0)
    apart = np.linalg.norm(geometry.pivots[1] - geometry.pivots[0])
    foot_of_limb(geometry, pose, 1, (0.45, 0.45 + 0.99 * apart), locked, along=along)
    for pair in ((0.45, 0.45 + 1.01 * apart), (0.6, 0.4), (np.nan, 0.5)):
        with pytest.raises(ValueError, match="do not meet"):
            foot_of_limb(geometry, pose, 1, pair, locked, along=along)


def test_a_turned_foot_turns_its_first_joint_back_and_no_other(geometry, poses, uneven):
    pose, feet = poses(1)[0], uneven(1)[0]
    joints = branch_joints(geometry, pose, feet, along="left")
    turned = feet.copy()
    turned[1] = turned_foot(feet[1], 0.3)
    after = branch_joints(geometry, pose, turned, along="left")
    expected = np.zeros((geometry.limbs, 6))
    expected[1, 0] = -0.3
    assert np.allclose(after - joints, expected, atol=1e-12)
    third = Rotation.from_euler("xyz", feet[1, 3:]).as_matrix()[:, 2]
    assert np.allclose(displacement(feet[1], turned[1]), (*(0.3 * third), 0.0, 0.0, 0.0))


def printed_joints(geometry, pose, foot, mended):
    """q_2 and q_5 of limb 1 by Eqs. (4) and (8) as printed, but for what is mended."""

    def unit(v):
        return v / np.linalg.norm(v)

    R = Rotation.from_euler("xyz", pose[3:]).as_matrix()
    u = R @ unit(geometry.pivots[1] - geometry.pivots[0])
    line = unit(pose[:3] + R @ geometry.middles[0] - foot[:3])
    z = Rotation.from_euler("xyz", foot[3:]).as_matrix()[:, 2]
    v_3 = unit(np.cross(u, line))
    z_2 = unit(z - (z @ v_3) * v_3)
    normal_4 = v_3 if mended else np.cross(u, line)
    normal_8 = unit(np.cross(z, v_3)) if mended else u
    q_5 = np.pi / 2 - np.arctan2(normal_4 @ np.cross(u, line), u @ line)
    q_2 = np.arctan2(normal_8 @ np.cross(z_2, z), z_2 @ z)
    return q_2, q_5


def test_printed_equations_4_and_8_do_not_return(poses):
    geometry = CentreGeometry()
    joints, off = branch_joints(geometry, poses(300, angle=0.3)), []
    for pose, own in zip(poses(300, angle=0.3), joints[:, 0], strict=True):
        mended = printed_joints(geometry, pose, geometry.footholds[0], mended=True)
        assert np.allclose(mended, own[[1, 4]], atol=1e-12)
        printed = printed_joints(geometry, pose, geometry.footholds[0], mended=False)
        off.append(np.abs(np.subtract(printed, mended)))
    largest = np.max(off, axis=0)
    assert 0.01 < largest[0] < 0.1  # q_2: some 11 mrad rms
    assert largest[1] > 1e-3


def test_a_chain_without_rates_is_nan():
    # The limb stretched along its foot's axis: q_1 and q_3 turn about one line.
    geometry = CentreGeometry()
    pose = (0.18 - geometry.middles[0, 0], 0.0, 0.48, 0.0, 0.0, 0.0)
    feet = geometry.footholds.copy()
    feet[0, 4] = np.pi / 2  # its axis in the limb's plane's normal
    _, rates = branch_joints_and_rates(geometry, pose, feet)
    assert np.isnan(rates[0]).all()
    assert np.isfinite(rates[1]).all()


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda g: branch_joints(g, np.zeros(6), along="right"), 'along must be "middle" or'),
        (lambda g: branch_forward(g, np.zeros((2, 6))), "joints must have shape"),
        (lambda g: branch_joints(g, np.zeros(5)), "pose must have shape"),
    ],
)
def test_wrong_arguments_are_called_by_their_names(geometry, call, says):
    with pytest.raises(ValueError, match=says):
        call(geometry)
