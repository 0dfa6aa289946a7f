import math

import numpy as np
import pytest

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.leg import swing_angle
from parapod.systems.levelling_platform.model import LegTransmission

LEGS = PlatformGeometry().legs
EXTENSION = np.array((0.392, 0.401, 0.409, 0.418))
RATE = np.array((0.01, -0.02, 0.03, 0.0))
TORQUE = np.array((40.0, -10.0, 55.0, 1.0))
INPUTS = {
    "rod_state": np.concatenate([EXTENSION, RATE]),
    "extension": EXTENSION,
    "swing_torque": TORQUE,
}


@pytest.fixture
def transmission(stand):
    """transmission(**changes): a transmission in the motion above, but for these inputs."""
    return lambda **changes: stand(LegTransmission(), **(INPUTS | changes))


def test_swing_angles_close_the_triangle_of_the_extensions_and_rates_are_their_derivatives(
    transmission,
):
    psi, rate = np.split(transmission()["swing_state"], 2)
    leg = LEGS[0]
    cosine = np.cos(psi - leg.alpha)
    squared = leg.l_3**2 + leg.l_4**2 + 2.0 * leg.l_3 * leg.l_4 * cosine
    np.testing.assert_allclose(np.sqrt(squared), EXTENSION, rtol=1e-14)
    step = 1e-6
    ahead, behind = (swing_angle(leg, EXTENSION + t * RATE) for t in (step, -step))
    np.testing.assert_allclose(rate, (ahead - behind) / (2.0 * step), atol=1e-9)


def test_power_at_the_rods_is_the_power_at_the_swing_joints(transmission):
    output = transmission()
    at_joints = TORQUE * output["swing_state"][4:]
    np.testing.assert_allclose(output["load_force"] * RATE, at_joints, rtol=1e-14, atol=1e-16)


def test_legs_are_alike_and_do_not_influence_each_other(transmission):
    order = [2, 0, 3, 1]
    straight = transmission()
    permuted = transmission(
        rod_state=np.concatenate([EXTENSION[order], RATE[order]]),
        extension=EXTENSION[order],
        swing_torque=TORQUE[order],
    )
    np.testing.assert_array_equal(permuted["load_force"], straight["load_force"][order])
    by_leg = straight["swing_state"].reshape(2, 4)[:, order]
    np.testing.assert_array_equal(permuted["swing_state"].reshape(2, 4), by_leg)


def test_load_is_taken_at_the_present_extension_not_at_the_one_ahead(transmission):
    ahead = np.concatenate([EXTENSION + 0.005, RATE])
    moved_on = transmission(rod_state=ahead)
    np.testing.assert_array_equal(moved_on["load_force"], transmission()["load_force"])


@pytest.mark.parametrize("bad", [math.nan, 0.3, 0.6])
def test_extension_that_cannot_be_built_gives_nan_for_its_leg_only(transmission, bad):
    extension = EXTENSION.copy()
    extension[1] = bad
    rods = np.concatenate([extension, RATE])
    output = transmission(rod_state=rods, extension=extension)
    assert np.isnan(output["swing_state"]).tolist() == [False, True, False, False] * 2
    assert np.isnan(output["load_force"]).tolist() == [False, True, False, False]
