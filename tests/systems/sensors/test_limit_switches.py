import math

import numpy as np
import pytest

from parapod.systems.sensors.limit_switches import LimitSwitches, LimitSwitchesParams

LIMIT_SWITCHES = LimitSwitchesParams(extended=0.4595, retracted=0.3805, contact_force=5.0)
STANDING = (20.0,) * 4


@pytest.fixture
def limits(stand):
    """limits(extension, force, switches): extended, retracted and contact of each leg."""

    def read(extension, force=STANDING, switches=None):
        switches = switches or LimitSwitches(len(extension), LIMIT_SWITCHES)
        shown = stand(switches, extension=extension, contact_force=force)
        return shown["limits"].reshape(3, -1)

    return read


def test_rows_are_extended_retracted_and_ground_contact(limits):
    extended, retracted, contact = limits((0.46, 0.38, 0.42, 0.42), (0.0, 0.0, 20.0, 0.0))
    np.testing.assert_array_equal(extended, (1, 0, 0, 0))
    np.testing.assert_array_equal(retracted, (0, 1, 0, 0))
    np.testing.assert_array_equal(contact, (0, 0, 1, 0))


def test_switches_close_half_a_millimetre_inside_the_end_stops(limits):
    extended, retracted, _ = limits((0.45949, 0.4595, 0.38051, 0.3805))
    np.testing.assert_array_equal(extended, (0, 1, 0, 0))
    np.testing.assert_array_equal(retracted, (0, 0, 0, 1))


def test_contact_closes_at_its_force(limits):
    *_, contact = limits((0.42,) * 4, (4.99, 5.0, -20.0, 5.01))
    np.testing.assert_array_equal(contact, (0, 1, 0, 1))


def test_thresholds_come_from_the_params(limits):
    switches = LimitSwitches(1, LimitSwitchesParams(0.3, 0.2, 1.0))
    for extension, force, expected in ((0.31, 0.5, (1, 0, 0)), (0.19, 1.5, (0, 1, 1))):
        result = limits((extension,), (force,), switches)
        np.testing.assert_array_equal(result.ravel(), expected)


def test_nan_closes_no_switch_and_infinity_counts_as_large(limits):
    bad = (math.nan, math.inf, -math.inf, 0.42)
    extended, retracted, contact = limits(bad, bad)
    np.testing.assert_array_equal(extended, (0, 1, 0, 0))
    np.testing.assert_array_equal(retracted, (0, 0, 1, 0))
    np.testing.assert_array_equal(contact, (0, 1, 0, 0))
