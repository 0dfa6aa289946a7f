import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.ground_estimator import GroundEstimator
from parapod.systems.levelling_platform.kinematics import estimate_ground, inverse_kinematics

GEOMETRY = PlatformGeometry(foot_radius=0.025)
GROUND = np.array((0.03, -0.05))
POSTURE = np.array((0.01, -0.02, 0.475))
EXTENSION = inverse_kinematics(GEOMETRY, POSTURE, GROUND)
PERIOD = 0.01


class Estimation:
    def __init__(self, fix, **inputs):
        self.system = GroundEstimator(GEOMETRY, PERIOD)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self._fix = fix
        self.set(**({"extension": EXTENSION, "attitude": POSTURE[:2], "trigger": (0.0,)} | inputs))

    def set(self, **inputs):
        self._fix(self.system, self.context, **inputs)

    def advance(self, steps=1):
        self.simulator.AdvanceTo(self.context.get_time() + steps * PERIOD)
        return tuple(
            self.system.GetOutputPort(name).Eval(self.context).copy()
            for name in ("ground", "valid")
        )


def test_estimate_is_the_ground_on_which_the_legs_stand(fix):
    ground, valid = Estimation(fix, trigger=(1.0,)).advance(2)
    np.testing.assert_allclose(ground, GROUND, rtol=0, atol=1e-13)
    assert valid.tolist() == [1.0]


def test_equal_extensions_on_a_slope_give_the_attitude_itself(fix):
    estimation = Estimation(fix, trigger=(1.0,), extension=[0.41] * 4, attitude=(0.02, 0.07))
    np.testing.assert_allclose(estimation.advance(2)[0], (0.02, 0.07), atol=1e-15)


def test_estimate_is_held_while_the_trigger_stays_up(fix):
    estimation = Estimation(fix, trigger=(1.0,))
    before, _ = estimation.advance(2)
    estimation.set(attitude=(0.05, 0.05))
    after, _ = estimation.advance(20)
    np.testing.assert_array_equal(after, before)


def test_estimate_is_held_when_the_trigger_falls_and_taken_anew_when_it_rises(fix):
    estimation = Estimation(fix, trigger=(1.0,))
    before, _ = estimation.advance(2)
    estimation.set(attitude=(0.05, 0.05), trigger=(0.0,))
    held, valid = estimation.advance(2)
    np.testing.assert_array_equal(held, before)
    assert valid.tolist() == [1.0]
    estimation.set(trigger=(1.0,))
    anew, _ = estimation.advance(2)
    expected = estimate_ground(GEOMETRY, EXTENSION, (0.05, 0.05))
    np.testing.assert_allclose(anew, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("trigger", [0.5, 0.0, -1.0, math.nan])
def test_trigger_that_is_not_above_a_half_takes_no_estimate(fix, trigger):
    assert Estimation(fix, trigger=(trigger,)).advance(3)[1].tolist() == [0.0]


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("extension", (math.nan, 0.4, 0.4, 0.4)),
        ("extension", (0.4, 0.4, math.inf, 0.4)),
        ("extension", (0.4, 0.4, 0.35, 0.4)),
        ("attitude", (math.nan, 0.0)),
        ("attitude", (0.0, math.inf)),
    ],
)
def test_bad_sample_is_not_taken_and_the_next_good_one_is(fix, name, bad):
    estimation = Estimation(fix, trigger=(1.0,), **{name: bad})
    ground, valid = estimation.advance(5)
    assert ground.tolist() == [0.0, 0.0]
    assert valid.tolist() == [0.0]
    estimation.set(extension=EXTENSION, attitude=POSTURE[:2])
    ground, valid = estimation.advance(2)
    np.testing.assert_allclose(ground, GROUND, rtol=0, atol=1e-13)
    assert valid.tolist() == [1.0]


@pytest.mark.parametrize(
    ("name", "bad"), [("attitude", (math.nan, 0.0)), ("extension", (0.4, 0.4, 0.35, 0.4))]
)
def test_bad_sample_leaves_the_last_estimate_but_it_is_not_valid(fix, name, bad):
    estimation = Estimation(fix, trigger=(1.0,))
    before, _ = estimation.advance(2)
    estimation.set(trigger=(0.0,))
    estimation.advance(2)
    estimation.set(trigger=(1.0,), **{name: bad})
    after, valid = estimation.advance(2)
    np.testing.assert_array_equal(after, before)
    assert valid.tolist() == [0.0]
    estimation.set(extension=EXTENSION, attitude=(0.05, 0.05))
    after, valid = estimation.advance(2)
    expected = estimate_ground(GEOMETRY, EXTENSION, (0.05, 0.05))
    np.testing.assert_allclose(after, expected, rtol=0, atol=1e-15)
    assert valid.tolist() == [1.0]


def test_encoder_count_moves_the_estimate_by_less_than_a_hundredth_of_a_degree(fix):
    exact, _ = Estimation(fix, trigger=(1.0,)).advance(2)
    counted = np.round(EXTENSION / 1e-5) * 1e-5
    rounded, _ = Estimation(fix, trigger=(1.0,), extension=counted).advance(2)
    assert 0.0 < np.abs(rounded - exact).max() < math.radians(0.01)
