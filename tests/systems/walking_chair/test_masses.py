from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.walking_chair.masses import ChairMasses, Passenger, centre_of_mass

MASSES = ChairMasses()
# Feet that are on both sides of S as far, and ahead of it and behind as far.
FEET = np.array([(-0.15, -0.2, -0.8), (0.15, -0.2, -0.8), (0.15, 0.2, -0.8), (-0.15, 0.2, -0.8)])


def test_the_chair_weighs_what_the_paper_measured():
    assert MASSES.total == pytest.approx(49.2, abs=1e-12)
    assert pytest.approx(1.16, abs=0.005) == Passenger().mass / MASSES.total


def test_a_leg_is_the_sum_of_its_parts():
    # Platform, three yokes and cylinders, two rods and a foot.
    assert MASSES.leg == pytest.approx(0.8 + 3 * 0.1 + 3 * 1.6 + 2 * 0.5 + 1.0)
    assert MASSES.total == pytest.approx(MASSES.body + 4 * MASSES.leg)


@pytest.mark.parametrize("part", ["body", "upper_platform", "yoke", "cylinder", "rod", "foot"])
def test_the_total_follows_every_part(part):
    count = {"body": 1, "upper_platform": 4, "yoke": 12, "cylinder": 12, "rod": 8, "foot": 4}
    heavier = replace(MASSES, **{part: getattr(MASSES, part) + 0.5})
    assert heavier.total - MASSES.total == pytest.approx(0.5 * count[part])


def test_centre_of_a_symmetric_chair_is_above_s():
    mass, centre = centre_of_mass(MASSES, Passenger(), FEET)
    assert mass == pytest.approx(106.2)
    assert centre[:2] == pytest.approx(0.0, abs=1e-15)
    height = (57.0 * 0.35 + 17.6 * 0.12 - 4 * 2.0 * 0.8) / 106.2
    assert centre[2] == pytest.approx(height)


def test_a_payload_aside_moves_the_centre_by_its_share():
    _, centre = centre_of_mass(MASSES, Passenger(x=0.08, y=-0.04), FEET)
    assert centre[:2] == pytest.approx(57.0 / 106.2 * np.array((0.08, -0.04)))


def test_a_foot_that_steps_takes_the_centre_with_it():
    steps = np.zeros((3, 4, 3))
    steps[1, 0, 1] = 0.1027
    steps[2, (0, 2), 1] = 0.1027
    _, centre = centre_of_mass(MASSES, Passenger(), FEET + steps)
    assert centre.shape == (3, 3)
    moved = (centre - centre[0])[:, 1]
    assert moved == pytest.approx(2.0 * 0.1027 / 106.2 * np.array((0.0, 1.0, 2.0)))


def test_place_of_the_passenger():
    assert Passenger(60.0, 0.01, 0.02, 0.3).place.tolist() == [0.01, 0.02, 0.3]
