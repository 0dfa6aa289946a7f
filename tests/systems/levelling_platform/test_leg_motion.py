"""Ramps of the legs, and feet that are kept on the ground."""

import math

import numpy as np
import pytest

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.leg_motion import ContactKeeper, LegRamp
from parapod.systems.levelling_platform.statics import KinematicPlatformParams, stand

PERIOD = 0.01
ACCELERATION = 0.1
STEP = ACCELERATION * PERIOD
MEASURED = np.array((0.45, 0.44, 0.43, 0.42))
POSTURE = np.array((0.40, 0.41, 0.42, 0.405, 0.001, -0.002, 0.003, -0.004))


@pytest.fixture
def begin(stand):
    """begin(**inputs): a ramp that is enabled and at rest, but for these inputs."""
    given = {
        "leg_rate": np.zeros(4),
        "extension": MEASURED,
        "posture_extension_state": POSTURE,
        "posture_control": 0.0,
        "enable": 1.0,
    }
    return lambda **inputs: stand(LegRamp(ACCELERATION, PERIOD), **(given | inputs))


@pytest.fixture
def ramp(begin):
    """A ramp at rest that has started."""
    return begin().tick()


def desired(ramp):
    return ramp["extension_desired_state"]


def test_it_starts_where_the_legs_are_and_then_looks_at_them_no_more(ramp):
    ramp.tick(10, extension=MEASURED + 0.01)
    np.testing.assert_array_equal(desired(ramp), [*MEASURED, 0, 0, 0, 0])


def test_rates_approach_the_wanted_ones_with_the_acceleration_and_positions_integrate_them(ramp):
    wanted = np.array((0.003, -0.006, 0.0005, 0.0))
    ramp.set(leg_rate=wanted)
    rates = [np.zeros(4)]
    for k in range(1, 20):
        rates.append(desired(ramp.tick())[4:])
        np.testing.assert_allclose(rates[-1], np.clip(wanted, -k * STEP, k * STEP), rtol=1e-12)
    travelled = PERIOD * (np.sum(rates, axis=0) - 0.5 * rates[-1])
    np.testing.assert_allclose(desired(ramp)[:4] - MEASURED, travelled, rtol=0, atol=1e-14)
    # It comes to rest with the same acceleration.
    ramp.set(leg_rate=np.zeros(4))
    rates = [desired(ramp.tick())[5] for _ in range(7)]
    np.testing.assert_allclose(rates, np.minimum(STEP * np.arange(1, 8) - 0.006, 0.0), atol=1e-17)


def test_a_posture_is_followed_at_once_and_the_ramp_goes_on_from_there(ramp):
    ramp.set(posture_control=1.0)
    np.testing.assert_array_equal(desired(ramp), POSTURE)
    ramp.tick().set(posture_control=0.0)
    np.testing.assert_array_equal(desired(ramp), POSTURE)
    rates = np.sign(POSTURE[4:]) * np.maximum(np.abs(POSTURE[4:]) - STEP, 0.0)
    way = 0.5 * PERIOD * (POSTURE[4:] + rates)
    np.testing.assert_allclose(desired(ramp.tick()), [*(POSTURE[:4] + way), *rates], rtol=1e-12)


def test_a_disabled_ramp_stays_with_the_legs(ramp):
    ramp.tick(20, leg_rate=np.full(4, 0.006)).set(enable=0.0)
    for extension in (MEASURED - 0.02, MEASURED - 0.03):
        ramp.tick(extension=extension)
        np.testing.assert_array_equal(desired(ramp), [*extension, 0, 0, 0, 0])
    ramp.set(enable=1.0)
    assert desired(ramp)[0] == MEASURED[0] - 0.03
    assert desired(ramp.tick())[4] == pytest.approx(STEP)


@pytest.mark.parametrize("off", [0.5, math.nan])
def test_a_switch_that_is_not_above_a_half_is_off(ramp, off):
    ramp.set(posture_control=off)
    np.testing.assert_array_equal(desired(ramp)[:4], MEASURED)
    ramp.tick(enable=off, extension=MEASURED - 0.02)
    np.testing.assert_array_equal(desired(ramp)[:4], MEASURED - 0.02)


# Bad input


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("element", [1, 5])
def test_a_posture_that_is_not_finite_is_passed_on_and_the_ramp_keeps_that_leg(ramp, bad, element):
    asked = POSTURE.copy()
    asked[element] = bad
    ramp.tick(posture_control=1.0, posture_extension_state=asked)
    np.testing.assert_array_equal(desired(ramp), asked)
    kept = desired(ramp.set(posture_control=0.0))
    assert (kept[1], kept[5]) == (MEASURED[1], 0.0)
    np.testing.assert_array_equal(np.delete(kept, (1, 5)), np.delete(POSTURE, (1, 5)))


def test_it_does_not_start_before_every_leg_is_measured(begin):
    ramp = begin(extension=(math.nan, *MEASURED[1:]), leg_rate=np.full(4, 0.001)).tick(5)
    assert np.isnan(desired(ramp)[0])
    ramp.tick(extension=MEASURED)
    np.testing.assert_array_equal(desired(ramp), [*MEASURED, 0, 0, 0, 0])


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_wanted_rate_that_is_not_finite_counts_as_zero(ramp, bad):
    ramp.tick(10, leg_rate=np.full(4, 0.003)).tick(10, leg_rate=(0.003, bad, 0.003, 0.003))
    np.testing.assert_allclose(desired(ramp)[4:], (0.003, 0.0, 0.003, 0.003), atol=1e-17)


# Feet that are kept on the ground


RATE, LIMIT, PRESS, PATIENCE = 5e-4, 3e-3, 2e-5, 0.1
CLOSED = (1.0, 1.0, 1.0, 1.0)


@pytest.fixture
def keep(stand):
    """keep(contact, **inputs): a keeper of `POSTURE` that sees these switches closed."""

    class Keeper(stand):
        def touch(self, *contact):
            return self.set(limits=[*[0] * 8, *contact])

        @property
        def trim(self):
            """Trim and its rate, which only the passive leg has."""
            change = self["extension_trimmed_state"] - POSTURE
            np.testing.assert_array_equal(np.delete(change, (3, 7)), np.zeros(6))
            return change[[3, 7]]

    def begin(contact=CLOSED, **inputs):
        keeper = Keeper(ContactKeeper(RATE, LIMIT, PRESS, PATIENCE, PERIOD))
        given = {"extension_desired_state": POSTURE, "enable": 1.0}
        return keeper.touch(*contact).set(**(given | inputs))

    return begin


@pytest.mark.parametrize(
    ("contact", "sign"),
    [
        (CLOSED, 0.0),
        # Without foot 2 or 4 the passive leg grows longer, without 1 or 3 shorter.
        ((1, 0, 1, 1), -1.0),
        ((1, 1, 1, 0), -1.0),
        ((1, 0, 1, 0), -1.0),
        ((0, 1, 1, 1), 1.0),
        ((1, 1, 0, 1), 1.0),
        ((0, 1, 0, 1), 1.0),
        # Feet of both diagonals tell nothing.
        ((0, 0, 1, 1), 0.0),
        ((0, 0, 0, 0), 0.0),
        ((1, 1, 0, 0), 0.0),
        # A switch that is not above a half is open.
        ((1, 1, 1, math.nan), -1.0),
        ((1, 1, 1, 0.5), -1.0),
    ],
)
def test_the_passive_leg_is_trimmed_by_the_diagonal_that_is_in_the_air(keep, contact, sign):
    trim = keep(contact).tick(7).trim
    np.testing.assert_allclose(trim, (sign * 7 * PERIOD * RATE, sign * RATE), atol=1e-16)


@pytest.mark.parametrize(("contact", "sign"), [((1, 0, 1, 1), -1.0), ((0, 1, 1, 1), 1.0)])
def test_the_trim_goes_on_a_little_when_all_switches_have_closed_and_then_stays(
    keep, contact, sign
):
    keeper = keep(contact).tick(20)
    trim, _ = keeper.trim
    keeper.touch(*CLOSED)
    trims = np.array([keeper.tick().trim for _ in range(20)])
    np.testing.assert_allclose(trims[-1], (trim + sign * PRESS, 0.0), rtol=1e-9, atol=1e-15)
    assert np.abs(trims[:, 1]).max() <= RATE * (1.0 + 1e-9)


@pytest.mark.parametrize(("contact", "sign"), [((1, 0, 1, 1), -1.0), ((0, 1, 1, 1), 1.0)])
def test_the_trim_ends_at_its_limit_with_rate_zero(keep, contact, sign):
    np.testing.assert_allclose(keep(contact).tick(700).trim, (sign * LIMIT, 0.0), atol=1e-16)


@pytest.mark.parametrize("off", [0.5, math.nan])
def test_a_disabled_keeper_trims_nothing(keep, off):
    keeper = keep((1, 0, 1, 1)).tick(5).tick(enable=off)
    assert keeper.trim.tolist() == [0.0, 0.0]


def test_switches_at_the_ends_of_the_stroke_do_not_count(keep):
    for ends in (0.0, 1.0):
        keeper = keep(limits=[*[ends] * 8, *CLOSED])
        assert keeper.tick(5).trim.tolist() == [0.0, 0.0]


def test_an_input_that_is_not_finite_is_passed_on_and_leaves_the_trim(keep):
    asked = POSTURE.copy()
    asked[[0, 3]] = math.nan
    keeper = keep((1, 0, 1, 1), extension_desired_state=asked).tick(2)
    assert np.isnan(keeper["extension_trimmed_state"]).tolist() == np.isnan(asked).tolist()
    trim = keeper.set(extension_desired_state=POSTURE).trim
    np.testing.assert_allclose(trim, (-2 * PERIOD * RATE, -RATE), atol=1e-16)


@pytest.mark.parametrize("error", [-2e-3, 2e-3])
def test_a_passive_leg_of_the_wrong_length_is_brought_to_the_ground(keep, error):
    """On a platform that stands on one diagonal, whatever foot is lifted."""
    geometry, params = PlatformGeometry(foot_radius=0.025), KinematicPlatformParams()
    keeper = keep(extension_desired_state=[0.405] * 4 + [0.0] * 4)
    opened = False
    for _ in range(500):
        extension = keeper["extension_trimmed_state"][:4].copy()
        extension[3] += error
        force = stand(
            geometry, params, extension.tolist(), [0.0] * 4, [0.0, 0.0], [0.0, 0.0]
        ).contact_force
        contact = [f >= 5.0 for f in force]
        opened |= not all(contact)
        keeper.touch(*contact).tick()
    assert opened
    assert all(contact)
    assert extension[3] == pytest.approx(0.405, abs=2e-4)


# Who stands


def test_a_foot_stands_while_its_switch_is_closed_and_a_little_longer(keep):
    keeper = keep().tick(3).touch(1, 0, 1, 1)
    stood = [keeper["standing"].tolist()]
    stood += [keeper.tick()["standing"].tolist() for _ in range(20)]
    periods = round(PATIENCE / PERIOD)
    assert all(feet == [1.0] * 4 for feet in stood[:periods])
    assert all(feet == [1.0, 0.0, 1.0, 1.0] for feet in stood[periods + 1 :])
    assert keeper.touch(*CLOSED)["standing"].tolist() == [1.0] * 4


@pytest.mark.parametrize("off", [0.0, math.nan])
def test_with_a_disabled_keeper_a_foot_stands_while_its_switch_is_closed_and_no_longer(keep, off):
    keeper = keep(enable=off).tick(3).touch(1, 0, 1, 1)
    assert keeper["standing"].tolist() == [1.0, 0.0, 1.0, 1.0]
    # One that was in the air when the keeper begins does not stand either.
    for _ in range(2):
        assert keeper.tick(3, enable=1.0)["standing"].tolist() == [1.0, 0.0, 1.0, 1.0]
