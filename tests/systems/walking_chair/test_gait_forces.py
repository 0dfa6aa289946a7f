import numpy as np
import pytest

from parapod.systems.walking_chair.checks import ForceExceeded, check_forces
from parapod.systems.walking_chair.gait import TrotGait, Walk, there_and_back
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import Passenger

GEOMETRY = ChairGeometry()


def test_the_papers_passenger_is_carried():
    check_forces(GEOMETRY, there_and_back(TrotGait()), Passenger(57.0))


def test_equally_stiff_branches_carry_what_the_best_distribution_does():
    # Linear programming gives 168.588 kg without friction; springs that share alike are near it.
    check_forces(GEOMETRY, Walk(), Passenger(140.0))
    with pytest.raises(ForceExceeded):
        check_forces(GEOMETRY, Walk(), Passenger(175.0))


def test_the_error_names_branch_time_and_limit():
    with pytest.raises(ForceExceeded) as caught:
        check_forces(GEOMETRY, Walk(), Passenger(57.0, 0.05, 0.0), limit=150.0)
    error = caught.value
    assert error.branch.startswith("branch ")
    assert 0.0 <= error.time <= 25.0
    assert abs(error.force) > error.limit == 150.0
    text = str(error)
    assert "\n" not in text
    assert error.branch in text
    assert f"{error.time:.3f} s" in text
    assert "150.0 N" in text


def test_the_largest_force_is_that_of_two_legs():
    with pytest.raises(ForceExceeded) as caught:
        check_forces(GEOMETRY, Walk(), Passenger(57.0), limit=1.0)
    standing = np.array(Walk().standing)[Walk().phase_at(caught.value.time)]
    assert standing.sum() == 2
