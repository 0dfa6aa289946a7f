"""Way that the feet tell, against that of the body in a gait, and turned chairs."""

from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.walking_chair.chair import chair_inverse, standing_feet
from parapod.systems.walking_chair.gait import TrotGait, Walk
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.odometry import FeetOdometer

CHAIR = ChairGeometry()
GAIT = TrotGait(cycles=2)


def walked(gait, step=0.02):
    """Times, lengths, feet that stand, and the body's positions in a gait."""
    walk = Walk((gait,))
    time = np.arange(0.0, walk.duration, step)
    motion = walk.motions(CHAIR, time)
    body = np.asarray(motion.body.position)
    lengths = chair_inverse(CHAIR, body, np.eye(3), motion.feet.position, motion.references)
    return time, lengths, np.asarray(motion.support, float), body


def way(time, lengths, stands, place):
    footing = FeetOdometer(CHAIR, place).add(time, lengths, stands)
    return footing.at(CHAIR, lengths)


@pytest.mark.parametrize("direction", ["forward", "back"])
@pytest.mark.parametrize("is_told", [True, False])
def test_feet_tell_the_way_of_the_body(direction, is_told):
    time, lengths, stands, body = walked(replace(GAIT, direction=direction))
    found = way(time, lengths, stands if is_told else None, body[0, :2])
    assert np.ptp(body[:, 1]) > 0.2
    tolerance = 5e-5 if is_told else 1e-3  # [m]; feet that are nearly down count a little
    np.testing.assert_allclose(found[:, :2], body[:, :2], atol=tolerance)
    np.testing.assert_allclose(found[:, 2], 0.0, atol=1e-3)


def test_the_way_does_not_depend_on_the_pieces_in_which_it_comes():
    time, lengths, stands, body = walked(GAIT, 0.05)
    whole = FeetOdometer(CHAIR, body[0, :2]).add(time, lengths, stands)
    odometer = FeetOdometer(CHAIR, body[0, :2])
    for part in np.array_split(np.arange(len(time)), 37):
        piece = odometer.add(time[part], lengths[part], stands[part])
        for mine, of_whole in zip(piece, whole, strict=True):
            np.testing.assert_allclose(mine, of_whole[part], atol=1e-12)


def test_a_chair_that_turns_on_its_feet_has_turned_by_the_angle_and_goes_its_own_way_ahead():
    body = np.array((0.3, -0.2, CHAIR.leg.retracted_height + 0.1))
    feet = standing_feet(CHAIR, body, "E1")

    def seen(angle, offset):
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
        place = body + turn @ np.array((0.0, offset, 0.0))
        return chair_inverse(CHAIR, place, turn, feet, "E1"), place

    angle = 0.03
    (before, _), (after, place) = seen(0.0, 0.0), seen(angle, 0.02)
    lengths = np.array([before, after])
    found = way(np.array([0.0, 10.0]), lengths, np.ones((2, 4)), body[:2])
    # Corners E_2 and E_3 of feet that lean and turn are taken for fixed, too.
    np.testing.assert_allclose(found[-1, :2], place[:2], atol=5e-3)
    assert found[-1, 2] == pytest.approx(angle, abs=6e-3)


def test_samples_that_are_not_finite_count_as_standing_still():
    time, lengths, stands, body = walked(GAIT, 0.05)
    holes = lengths.copy()
    holes[100:120] = np.nan  # within one phase
    found = way(time, holes, stands, body[0, :2])
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[-1, :2], body[-1, :2], atol=1e-3)
    unknown = way(time, np.full_like(lengths, np.nan), stands, body[0, :2])
    np.testing.assert_array_equal(unknown, np.tile([*body[0, :2], 0.0], (len(time), 1)))
