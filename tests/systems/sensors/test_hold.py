"""Holds that begin with a value."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.sensors.hold import Hold


def test_a_hold_shows_its_initial_value_until_the_first_sample_and_then_the_last_sample(fix):
    hold = Hold(0.01, (1.0, 2.0))
    simulator = Simulator(hold)
    context = simulator.get_mutable_context()
    fix(hold, context, signal=(3.0, 4.0))
    simulator.Initialize()
    held = hold.GetOutputPort("held")
    assert held.Eval(context).tolist() == [1.0, 2.0]
    for time, signal, expected in (
        (0.005, (5.0, 6.0), (3.0, 4.0)),
        (0.009, (7.0, 8.0), (3.0, 4.0)),
        (0.015, (9.0, 9.0), (7.0, 8.0)),
    ):
        simulator.AdvanceTo(time)
        fix(hold, context, signal=signal)
        assert held.Eval(context).tolist() == list(expected)


def test_a_value_that_is_set_is_shown_until_the_next_sample(fix):
    hold = Hold(0.01, (1.0,))
    simulator = Simulator(hold)
    context = simulator.get_mutable_context()
    fix(hold, context, signal=(3.0,))
    simulator.AdvanceTo(0.005)
    hold.set_value(context, (2.0,))
    assert hold.GetOutputPort("held").Eval(context).tolist() == [2.0]
    simulator.AdvanceTo(0.015)
    assert hold.GetOutputPort("held").Eval(context).tolist() == [3.0]


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_bad_sample_passes_and_is_gone_with_the_next_one(fix, bad):
    hold = Hold(0.01, (1.0,))
    simulator = Simulator(hold)
    context = simulator.get_mutable_context()
    for time, signal in ((0.005, bad), (0.015, 4.0)):
        fix(hold, context, signal=(signal,))
        simulator.AdvanceTo(time)
        np.testing.assert_array_equal(hold.GetOutputPort("held").Eval(context), [signal])
