import numpy as np

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.turntable import stability_margin


def test_stability_margins_of_a_batch_are_those_of_its_machines():
    random = np.random.default_rng(3)
    extension = random.uniform(0.395, 0.415, (2, 3, 4))
    attitude = random.uniform(-0.05, 0.05, (2, 3, 2))
    centre = random.uniform(-0.05, 0.05, (2, 3, 3))
    geometry = PlatformGeometry()
    margins = stability_margin(geometry, extension, attitude, centre)
    singles = [
        [stability_margin(geometry, *one) for one in zip(*row, strict=True)]
        for row in zip(extension, attitude, centre, strict=True)
    ]
    np.testing.assert_allclose(margins, singles, rtol=1e-12)
    assert np.ptp(margins) > 0.01
