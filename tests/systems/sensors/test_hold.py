"""Holds that begin with a value."""

import math

import numpy as np

from parapod.systems.sensors.hold import Hold


def test_a_hold_shows_its_initial_value_until_the_first_sample_and_then_the_last_sample(stand):
    hold = stand(Hold(0.01, (1.0, 2.0)), signal=(3.0, 4.0))
    assert hold["held"].tolist() == [1.0, 2.0]
    for time, signal, expected in (
        (0.005, (5.0, math.nan), (3.0, 4.0)),
        (0.009, (7.0, math.inf), (3.0, 4.0)),
        # A bad sample passes and is gone with the next one.
        (0.015, (9.0, 9.0), (7.0, math.inf)),
        (0.025, (0.0, 0.0), (9.0, 9.0)),
    ):
        hold.run(time).set(signal=signal)
        np.testing.assert_array_equal(hold["held"], expected)


def test_a_value_that_is_set_is_shown_until_the_next_sample(stand):
    hold = stand(Hold(0.01, (1.0,)), signal=3.0).run(0.005)
    hold.system.set_value(hold.context, (2.0,))
    assert hold["held"] == 2.0
    assert hold.run(0.015)["held"] == 3.0
