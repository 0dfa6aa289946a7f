"""Controls of a person: shown for a while and then gone, and read in SI units."""

import math

import numpy as np
import pytest
from pydrake.geometry import Meshcat

from parapod.systems.core.controls import PoseSliders, is_held, shown


class Held:
    """Buttons that are held, and refuse a name that they have."""

    def __init__(self):
        self.held = {}

    def AddHold(self, name, key=""):
        if name in self.held:
            raise ValueError(name)
        self.held[name] = False

    def DeleteHold(self, name, strict=True):
        del self.held[name]

    def GetHoldNames(self):
        return list(self.held)

    def IsHeld(self, name):
        return self.held[name]


def test_sliders_and_buttons_are_there_for_a_while():
    meshcat = Meshcat()
    with shown(meshcat, [("x", -1.0, 1.0, 0.1, 0.0)], ["Go"]):
        assert meshcat.GetSliderNames() == ["x"]
        assert meshcat.GetButtonClicks("Go") == 0
    assert meshcat.GetSliderNames() == []
    with pytest.raises(RuntimeError, match="Go"):
        meshcat.GetButtonClicks("Go")


def test_what_is_shown_goes_where_the_rest_cannot_be():
    controls = Held()
    controls.AddHold("b")
    with pytest.raises(ValueError, match="b"), shown(controls, holds=[("a", ""), ("b", "")]):
        raise AssertionError("it was shown twice")
    assert controls.GetHoldNames() == ["b"]


def test_a_button_that_is_not_there_is_not_held():
    controls = Held()
    assert not is_held(controls, "a")
    with shown(controls, holds=[("a", "ArrowUp")]):
        assert not is_held(controls, "a")
        controls.held["a"] = True
        assert is_held(controls, "a")
    assert not is_held(controls, "a")


def test_a_pose_is_read_in_si_units_and_is_the_first_one_without_sliders():
    meshcat, first = Meshcat(), np.array([0.0123, -0.5])
    elements = (("x [mm]", 80.0, 1.0, 1e-3), ("turn [deg]", 15.0, 0.5, math.radians(1.0)))
    sliders = PoseSliders(meshcat, elements, first)
    np.testing.assert_array_equal(sliders.read(), first)
    assert sliders.rows() == [
        ("x [mm]", -68.0, 92.0, 1.0, 12.0),
        ("turn [deg]", -43.5, -13.5, 0.5, -28.5),
    ]
    with shown(meshcat, sliders.rows()):
        meshcat.SetSliderValue("x [mm]", 90.0)
        np.testing.assert_allclose(sliders.read(), [0.09, np.radians(-28.5)], atol=1e-12)
    np.testing.assert_array_equal(sliders.read(), first)
