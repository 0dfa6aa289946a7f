"""The chair's leg on the slide: its foot on a plate, hand-computed; its control; an even load."""

import math

import numpy as np
import pytest

from parapod.systems.terrain_simulator.chair_leg import (
    ChairLegController,
    ChairLegModel,
    ChairLegMount,
    ChairScrewParams,
)
from parapod.systems.terrain_simulator.gait import Gait
from parapod.systems.terrain_simulator.support import Support
from parapod.systems.walking_chair.leg import foot_rotation, leg_corners, up_of_lengths

# Length of a leg that stands straight as the chair does before its first step, Table 1 [m].
STRAIGHT = (0.7061, 0.687769, 0.687769)
HEIGHT = 0.7801
SEEN = [0, 2]  # x and z
MOUNTS = {
    "front leg": ChairLegMount(),
    "rear leg": ChairLegMount(turned=True),
    "uphill": ChairLegMount(True, math.radians(10.0), 0.029),
    "downhill": ChairLegMount(False, math.radians(-10.0), -0.029),
}
each_mount = pytest.mark.parametrize("mount", MOUNTS.values(), ids=MOUNTS)


def corners_of(model, lengths):
    """Corners E_1, E_2, E_3 from the hip (3, 3) [m]."""
    corners = leg_corners(model.geometry, up_of_lengths(model.geometry, lengths))
    return corners @ model.R_HA.T + model.p_HA


@each_mount
def test_the_leg_hangs_straight_over_the_place_where_its_sole_is_flat(mount):
    model, phi = ChairLegModel(mount), -mount.lean
    flat = mount.ahead * np.array((math.cos(phi), -math.sin(phi))) - (0.0, HEIGHT)
    lengths = model.lengths(flat, phi)
    np.testing.assert_allclose(lengths, STRAIGHT, atol=1e-6)
    corners = corners_of(model, lengths)
    off = np.array((math.sin(phi), 0.0, math.cos(phi)))
    np.testing.assert_allclose(corners @ off, flat @ off[SEEN], atol=1e-12)
    tip, *edge = corners[:, 0]
    assert (tip < min(edge)) == mount.turned
    np.testing.assert_allclose(corners[:, 1].sum(), 0.0, atol=1e-12)


@each_mount
@pytest.mark.parametrize("shift", [-0.04, 0.03])
def test_no_corner_is_below_the_plate_and_the_lowest_keeps_to_it(mount, shift):
    """The sole's tilt against the plate is that of the UP branch, about shift / height."""
    model, phi = ChairLegModel(mount), -mount.lean
    along, off = (math.cos(phi), -math.sin(phi)), np.array((math.sin(phi), math.cos(phi)))
    place = (mount.ahead + shift) * np.array(along) - (0.0, HEIGHT)
    lengths = model.lengths(place, phi)
    heights = corners_of(model, lengths)[:, SEEN] @ off - place @ off
    assert heights.min() == pytest.approx(0.0, abs=1e-12)
    sole = 0.5 * math.sqrt(3.0) * 0.12
    assert heights.max() == pytest.approx(sole * abs(shift) / 0.7261, rel=0.15)
    assert (heights[0] < 1e-9) == ((shift < 0.0) != mount.turned)
    lowest = corners_of(model, lengths)[np.argmin(heights), SEEN]
    assert np.linalg.norm(lowest - place) == pytest.approx(0.5 * sole, abs=1e-12)
    np.testing.assert_allclose(model.places(lengths, np.array(phi)), place, atol=1e-12)
    # alpha is zero: the foot stays in the bench's plane.
    np.testing.assert_allclose(
        foot_rotation(up_of_lengths(model.geometry, lengths))[:, 0], (1.0, 0.0, 0.0), atol=1e-9
    )


def test_rates_of_the_branches_are_those_of_their_lengths():
    model = ChairLegModel(MOUNTS["downhill"])

    def way(t):
        """Place of the foot with its derivatives (3, 2), and the plate's angle (3)."""
        s, c = math.sin(5.0 * t), math.cos(5.0 * t)
        foot = ((0.02 * s, -HEIGHT + 0.01 * c), (0.1 * c, -0.05 * s), (-0.5 * s, -0.25 * c))
        return np.array(foot), np.array((0.17 + 0.02 * s, 0.1 * c, -0.5 * s))

    found, h = model.branches(*way(0.3)), 1e-4
    before, after = (model.branches(*way(0.3 + step)) for step in (-h, h))
    np.testing.assert_allclose(
        found.velocity, (after.length - before.length) / (2.0 * h), atol=1e-5
    )
    np.testing.assert_allclose(
        found.acceleration, (after.velocity - before.velocity) / (2.0 * h), atol=1e-3
    )


def test_screws_are_pushed_to_where_the_foot_is_asked_to_be():
    """1 N for a micrometre, 20 N for a mm/s; the rotor's mass for an acceleration."""
    screws = ChairScrewParams()
    controller = ChairLegController(screws=screws)
    context = controller.CreateDefaultContext()
    for name, value in (
        ("position", np.array(STRAIGHT) - 50e-6),
        ("velocity", (1e-3, 0.0, 0.0)),
        ("foot_desired", (0.0, -HEIGHT, 0.0, 0.0, 0.0, -1.0)),
        ("plate_motion", (0.5, 0.3, *(0.0,) * 7)),
    ):
        controller.GetInputPort(name).FixValue(context, value)
    force = controller.get_output_port().Eval(context)
    # The foot goes down by 1 m/s^2: the UP branch as fast, the others by their slope, .9932.
    expected = 50.0 + screws.inertia * np.array((1.0, 0.99321, 0.99321)) - (20.0, 0.0, 0.0)
    np.testing.assert_allclose(force, expected, atol=0.5)
    assert screws.inertia == pytest.approx(130.3, abs=0.1)


def test_an_even_load_is_handed_over_and_lifts_no_body():
    support = Support(Gait(0.06, 0.75, duty=0.6), 26.55, is_even=True)
    share = np.linspace(0.0, 1.0, 1001)[:-1]
    both = support.force(share) + support.force(share + 0.5)
    np.testing.assert_allclose(both, 2.0 * 26.55 * 9.81, rtol=1e-12)
    assert support.force(share).mean() == pytest.approx(support.weight, rel=1e-9)
    assert support.force(np.array((0.05, 0.3, 0.55, 0.6, 0.8))) == pytest.approx(
        support.peak * np.array((0.5, 1.0, 0.5, 0.0, 0.0))
    )
    assert not support.bounce(share).any()


def test_an_even_load_needs_a_stance_in_which_both_pairs_stand():
    with pytest.raises(ValueError, match=r"a duty above 0\.5, not 0\.5"):
        Support(Gait(1.0, duty=0.5), 30.0, is_even=True)
