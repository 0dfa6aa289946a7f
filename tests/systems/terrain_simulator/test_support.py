"""The force of a stance and the bounce of the body: means, jumps, derivatives."""

import numpy as np
import pytest

from parapod.systems.core.physics import GRAVITY
from parapod.systems.terrain_simulator.gait import Gait
from parapod.systems.terrain_simulator.support import Support

SHARES = np.linspace(0.0, 1.0, 4001)
duties = pytest.mark.parametrize("duty", [0.3, 0.5, 0.65])


def support(duty, frequency=2.0):
    return Support(Gait(1.0, frequency, duty), 30.0)


@duties
def test_the_mean_force_is_the_weight(duty):
    force = support(duty).force(SHARES)
    assert np.trapezoid(force, SHARES) == pytest.approx(30.0 * GRAVITY, rel=1e-5)
    assert (force[duty + 1e-9 < SHARES] == 0.0).all()


def test_the_trot_of_a_robot_of_120_kg_presses_with_925_n():
    assert support(0.5).peak == pytest.approx(925.0, abs=0.5)


@duties
def test_two_legs_by_turns_move_the_body_as_newton_has_it(duty):
    one = support(duty)
    height, rate, acceleration = one.bounce(SHARES)
    both = 0.5 * (one.force(SHARES) + one.force(SHARES + 0.5))
    np.testing.assert_allclose(acceleration, both / 30.0 - GRAVITY, atol=1e-12)
    time = SHARES / 2.0
    np.testing.assert_allclose(np.gradient(height, time)[1:-1], rate[1:-1], atol=2e-3)
    np.testing.assert_allclose(np.gradient(rate, time)[1:-1], acceleration[1:-1], atol=2e-2)


@duties
def test_the_bounce_repeats_itself_about_its_mean(duty):
    height, rate, _ = support(duty).bounce(SHARES)
    assert np.trapezoid(height, SHARES) == pytest.approx(0.0, abs=1e-9)
    assert height[0] == pytest.approx(height[-1], abs=1e-12)
    assert rate[0] == pytest.approx(rate[-1], abs=1e-12)


def test_at_half_the_frequency_the_body_bounces_four_times_as_high():
    fast, slow = (np.ptp(support(0.5, f).bounce(SHARES)[0]) for f in (2.0, 1.0))
    assert slow == pytest.approx(4.0 * fast)


def test_a_body_without_mass_is_refused():
    with pytest.raises(ValueError, match="mass must be positive, not 0"):
        Support(Gait(1.0), 0.0)
