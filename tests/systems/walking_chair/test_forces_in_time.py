import pytest

from parapod.systems.walking_chair.checks import ForceExceeded, check_forces
from parapod.systems.walking_chair.gait import TrotGait, Walk
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import Passenger


@pytest.mark.parametrize("passenger", [Passenger(57.0, 0.0, 0.05), Passenger(57.0, 0.1, 0.1)])
def test_a_gait_that_takes_longer_exceeds_the_same_force_at_the_same_share_of_its_time(passenger):
    """At rest forces depend on where feet and body are; five instants a phase are looked at."""
    found = []
    for duration in (5.0, 3.0, 0.7):
        walk = Walk((TrotGait(phase_duration=duration),))
        with pytest.raises(ForceExceeded) as caught:
            check_forces(ChairGeometry(), walk, passenger, limit=1.0)
        instant = 5.0 * caught.value.time / duration
        assert instant == pytest.approx(round(instant), abs=1e-9)
        found.append((round(instant), caught.value.branch, caught.value.force))
    for instant, branch, force in found[1:]:
        assert (instant, branch) == found[0][:2]
        assert force == pytest.approx(found[0][2], rel=1e-9)
