"""Inclination that displaces a rod's modes: the right way, and within limit and stroke."""

import math

import numpy as np
import pytest

from parapod.systems.arm.vibration import LumpedRod
from parapod.systems.core.triples import cross, dot, plus
from parapod.systems.levelling_platform.damped_posture import DampedPosture
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.statics import PAPER_ARM

ROD = LumpedRod(1.9, (14.0, 12.0), 0.01)
DESIRED = [0.0, 0.0, 0.477, 1e-3, 2e-3, 3e-3]
GROUND = [math.radians(2.0), math.radians(3.0)]


def shown(stand, system=None, **inputs):
    usual = {
        "posture_desired_state": DESIRED,
        "displacement": [0.02, -0.01, 0.1, 0.2],
        "arm_position": [0.4, 0.6],
        "ground": GROUND,
    }
    return stand(system or DampedPosture(ROD, PAPER_ARM), **(usual | inputs))[
        "posture_damped_state"
    ]


@pytest.mark.parametrize("position", [(0.0, 0.0), (0.4, 0.6), (-2.0, 1.2), (1.0, -0.9)])
def test_the_inclination_moves_the_places_as_far_as_is_asked(stand, position):
    displacement = (0.01, -0.004, 0.1, 0.2)
    posture = shown(stand, displacement=displacement, arm_position=position)
    added = posture - DESIRED
    assert added[2] == added[5] == 0.0
    for first, second, offset in ((0, 1, 0), (3, 4, 2)):
        inclination = added[first], added[second], 0.0
        for plane, (place, axis) in enumerate(ROD.places(PAPER_ARM, position)):
            moved = dot(axis, cross(inclination, plus(place, (0.0, 0.0, DESIRED[2]))))
            assert moved == pytest.approx(displacement[offset + plane], rel=1e-9)


def test_no_displacement_leaves_the_posture_as_it_is(stand):
    np.testing.assert_array_equal(shown(stand, displacement=np.zeros(4)), DESIRED)
    np.testing.assert_array_equal(shown(stand, displacement=[math.nan, 0, 0, 0]), DESIRED)
    np.testing.assert_array_equal(shown(stand, arm_position=[math.inf, 0.0]), DESIRED)


def test_the_limit_holds_and_its_rate_ends(stand):
    limit = math.radians(0.5)
    system = DampedPosture(ROD, PAPER_ARM, limit=limit)
    posture = shown(stand, system, displacement=[9.0, -9.0, 1.0, 1.0], arm_position=[0.0, 0.0])
    np.testing.assert_allclose(np.abs(posture[:2]), limit)
    np.testing.assert_array_equal(posture[3:], DESIRED[3:])


@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_the_legs_stay_inside_the_stroke(stand, signs):
    longer = PlatformGeometry(extension_min=0.38, extension_max=0.43)
    displacement = [0.12 * signs[0], 0.12 * signs[1], 0.0, 0.0]
    posture = shown(stand, displacement=displacement, arm_position=[0.0, 0.0])
    extension = inverse_kinematics(longer, posture[:3], np.array(GROUND))
    assert extension.min() > 0.39 - 5e-5
    assert extension.max() < 0.42 + 5e-5
    assert 0.0 < np.abs(posture[:2]).max() < math.radians(2.9)
    free = shown(stand, displacement=displacement, arm_position=[0.0, 0.0], ground=[0.0, 0.0])
    np.testing.assert_array_less(np.abs(posture[:2]), np.abs(free[:2]) + 1e-12)
