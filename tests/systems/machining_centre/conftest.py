import numpy as np
import pytest

from parapod.systems.machining_centre.geometry import CentreGeometry


@pytest.fixture(params=[3, 4], ids=["tripod", "quadruped"])
def geometry(request):
    return CentreGeometry(request.param)


@pytest.fixture
def poses():
    """poses(count, angle): poses in the stroke's middle."""

    def draw(count, angle=0.25, seed=0):
        rng = np.random.default_rng(seed)
        low, high = np.array((-0.05, -0.05, 0.46)), np.array((0.05, 0.05, 0.52))
        return np.hstack(
            (rng.uniform(low, high, (count, 3)), rng.uniform(-angle, angle, (count, 3)))
        )

    return draw


@pytest.fixture
def uneven(geometry):
    """uneven(count): footholds off the pattern, tilted."""

    def draw(count, seed=1):
        shape = (count, *geometry.footholds.shape)
        return geometry.footholds + np.random.default_rng(seed).uniform(-0.03, 0.03, shape)

    return draw
