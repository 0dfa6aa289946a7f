import numpy as np
import pytest

from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import singularity

# Where P, T and A_3 are nearer to one line, rounding is magnified.
FROM_LINE = 0.05


@pytest.fixture(params=["pedal", "treadmill"])
def geometry(request):
    return getattr(BenchGeometry, request.param)()


@pytest.fixture
def poses(geometry):
    """poses(count): poses that can be assembled, whatever the rails' ends."""

    def draw(count, seed=0):
        rng = np.random.default_rng(seed)
        tilt = np.radians(45.0 if geometry.strut_ahead else 14.0)
        drawn = rng.uniform((0.2, 0.05, -tilt), (1.2, 0.34, tilt), (8 * count, 3))
        at = singularity(geometry, drawn)
        kept = (at.sin_mu > FROM_LINE) & (at.height > FROM_LINE) & (at.spread > FROM_LINE)
        kept &= at.lean > FROM_LINE
        assert kept.sum() >= count
        return drawn[kept][:count]

    return draw
