import math

import numpy as np

from parapod.systems.levelling_platform.model import LIMIT_SWITCHES
from parapod.systems.sensors.limit_switches import LimitSwitches, LimitSwitchesParams

STANDING = (20.0,) * 4


def limits(extension, force=STANDING, switches=None):
    switches = switches or LimitSwitches(len(extension), LIMIT_SWITCHES)
    context = switches.CreateDefaultContext()
    switches.GetInputPort("extension").FixValue(context, extension)
    if force is not None:
        switches.GetInputPort("contact_force").FixValue(context, force)
    return switches.get_output_port().Eval(context).reshape(3, -1)


def test_rows_are_extended_retracted_and_ground_contact():
    extended, retracted, contact = limits((0.46, 0.38, 0.42, 0.42), (0.0, 0.0, 20.0, 0.0))
    np.testing.assert_array_equal(extended, (1, 0, 0, 0))
    np.testing.assert_array_equal(retracted, (0, 1, 0, 0))
    np.testing.assert_array_equal(contact, (0, 0, 1, 0))


def test_switches_close_half_a_millimetre_inside_the_end_stops():
    extended, retracted, _ = limits((0.45949, 0.4595, 0.38051, 0.3805))
    np.testing.assert_array_equal(extended, (0, 1, 0, 0))
    np.testing.assert_array_equal(retracted, (0, 0, 0, 1))


def test_contact_closes_at_its_force():
    *_, contact = limits((0.42,) * 4, (4.99, 5.0, -20.0, 5.01))
    np.testing.assert_array_equal(contact, (0, 1, 0, 1))


def test_thresholds_come_from_the_params():
    switches = LimitSwitches(1, LimitSwitchesParams(0.3, 0.2, 1.0))
    for extension, force, expected in ((0.31, 0.5, (1, 0, 0)), (0.19, 1.5, (0, 1, 1))):
        result = limits((extension,), (force,), switches)
        np.testing.assert_array_equal(result.ravel(), expected)


def test_nan_closes_no_switch_and_infinity_counts_as_large():
    bad = (math.nan, math.inf, -math.inf, 0.42)
    extended, retracted, contact = limits(bad, bad)
    np.testing.assert_array_equal(extended, (0, 1, 0, 0))
    np.testing.assert_array_equal(retracted, (0, 0, 1, 0))
    np.testing.assert_array_equal(contact, (0, 1, 0, 0))
