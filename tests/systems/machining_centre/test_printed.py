"""Equations as printed agree with the right ones where their misprints make no difference."""

import numpy as np
import pytest

from parapod.systems.machining_centre.branch import branch_joints
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import jacobian
from parapod.systems.machining_centre.printed import printed_jacobian, printed_joints

HOME = np.array((0.0, 0.0, 0.48, 0.0, 0.0, 0.0))
TILTED = np.array((0.03, 0.02, 0.5, 0.05, -0.15, 0.05))
# q_1 .. q_6, of which each equation gives one.
GIVEN = {4: 4, 8: 1, "v_c": 5}


@pytest.mark.parametrize("equation", [4, 8])
def test_normals_make_no_difference_at_a_symmetric_pose(equation):
    geometry = CentreGeometry()
    printed = printed_joints(geometry, HOME, equation)
    assert np.allclose(printed, branch_joints(geometry, HOME)[0], atol=1e-14)


@pytest.mark.parametrize("equation", GIVEN)
def test_an_equation_changes_its_own_joint_alone(equation):
    geometry = CentreGeometry()
    off = np.abs(printed_joints(geometry, TILTED, equation) - branch_joints(geometry, TILTED)[0])
    own = GIVEN[equation]
    assert off[own] > 1e-4
    assert np.delete(off, own).max() == 0.0


def test_the_printed_jacobian_is_right_for_a_platform_at_the_world_s_origin():
    # There the platform's point at the origin is P_O.
    geometry = CentreGeometry()
    pose = np.array((0.0, 0.0, 0.0, 0.1, 0.05, 0.2))
    assert np.allclose(printed_jacobian(geometry, pose), jacobian(geometry, pose), atol=1e-15)


def test_another_equation_is_refused():
    with pytest.raises(ValueError, match='equation must be 4, 8 or "v_c", not 5'):
        printed_joints(CentreGeometry(), HOME, 5)
