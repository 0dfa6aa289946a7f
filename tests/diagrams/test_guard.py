"""Ticks of a loop that can be compared with the one before."""

import numpy as np
import pytest

from parapod.diagrams.guard import AGE, POSITION, SignGuard, Ticks, Trip, Tripped


def test_a_tick_is_regular_a_period_after_the_one_before_and_at_most_half_of_one_off():
    ticks = Ticks(0.01)
    gaps = (0.0, 0.01, 0.0149, 0.0151, 0.0051, 0.0049, 0.01, 1.0, 0.01)
    now, regular = 100.0, []
    for gap in gaps:
        now += gap
        regular.append(ticks.is_regular(now))
    assert regular == [False, True, True, False, True, False, True, False, True]


class AgeGuard(SignGuard):
    """Watches the age alone."""

    signals = frozenset((AGE, POSITION))

    def _signs(self, is_regular, elapsed, values):
        yield from self._stale(values, UsualLimits)


class UsualLimits:
    fastest, persists = 1.0, 0.1


@pytest.mark.parametrize(("allowed", "limit"), [(0.0, 0.06), (0.02, 0.06), (0.08, 0.08)])
def test_measurements_may_be_as_old_as_usual_or_as_is_allowed(allowed, limit):
    for age, name in (
        (limit - 0.005, None),
        (limit + 0.005, "legs_stale"),
        (np.nan, "legs_stale"),
    ):
        guard = AgeGuard(0.01, oldest=0.06)
        assert guard.allow_age(allowed) == 0.06
        values = {AGE: np.array([age]), POSITION: np.zeros(4)}
        trips = [guard.check(5.0 + 0.01 * k, values) for k in range(20)]
        assert (trips[-1].name if trips[-1] else None) == name


def test_a_tripped_job_says_its_reason_and_its_sign():
    trip = Trip("encoder_jump", "a leg that jumps", ("legs",))
    assert str(Tripped(trip)) == "encoder_jump: a leg that jumps; the job has been ended"
