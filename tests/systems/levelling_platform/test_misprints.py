"""The paper's equations as they are printed: what a misprint changes, by hand."""

import numpy as np
import pytest

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.printed import omega


def test_the_misprint_of_equation_24_leaves_the_residual_of_its_component():
    """Feet in the second component: l_x instead of l_y, so 400 mm instead of -170 or 170 mm."""
    legs, d, ground = PlatformGeometry().legs[:3], (0.40, 0.41, 0.405), (0.05, -0.03)
    meant, printed = (
        omega(legs, d, ground, 0.0, 0.0, 0.48, as_printed=as_printed)
        for as_printed in (False, True)
    )
    g_2 = -np.sin(0.05)
    # Of legs 1 and 2, of legs 1 and 3, and of leg 1: what is added to their second component.
    added = np.array([(0.4 + 0.17) - (0.4 - 0.17), (0.4 + 0.17) - (-0.4 - 0.17), 0.4 + 0.17])
    np.testing.assert_allclose(printed - meant, g_2 * added, rtol=1e-12)
    assert omega(legs, d, ground, 0.0, 0.0, 0.48) == pytest.approx(meant, abs=0.0)
