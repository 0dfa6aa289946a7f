"""Ticks of a loop that can be compared with the one before."""

import numpy as np
import pytest

from parapod.diagrams.guard import AGE, POSITION, DriveLimits, SignGuard, Ticks, Trip, Tripped


def test_a_tick_is_regular_a_period_after_the_one_before_and_at_most_half_of_one_off():
    ticks = Ticks(0.01)
    gaps = (0.0, 0.01, 0.0149, 0.0151, 0.0051, 0.0049, 0.01, 1.0, 0.01)
    now, regular = 100.0, []
    for gap in gaps:
        now += gap
        regular.append(ticks.is_regular(now))
    assert regular == [False, True, True, False, True, False, True, False, True]


class PlainGuard(SignGuard):
    """Has the signs of all drives alone; the axes are led to zero."""

    signals = frozenset((AGE, POSITION))

    def _distances(self, values):
        return values[POSITION]


LIMITS = DriveLimits(following=2e-3, fastest=1.0, current=5.0)
REST = {AGE: np.zeros(1), POSITION: np.zeros(4)}
# Values, words, and parts that are suspect.
SIGNS = {
    "following_error": ({POSITION: [0.0, 0.0, -2.1e-3, 3e-3]}, "is more than 2 mm off", ("legs",)),
    "encoder_jump": ({POSITION: [0.0, 0.0, 0.011, 0.0]}, "changes faster than it can", ("legs",)),
    "overload": ({"legs.current": [0.0, 5.0, -5.1, 0.0]}, "pushes harder than it may", ()),
}


@pytest.mark.parametrize(("name", "sign"), SIGNS.items(), ids=SIGNS)
def test_signs_of_all_drives_name_the_first_axis_that_shows_them(name, sign):
    changes, words, distrusted = sign
    guard, trip = PlainGuard(0.01, LIMITS), None
    for k in range(30):
        later = {signal: np.array(value) for signal, value in changes.items()} if k > 9 else {}
        trip = trip or guard.check(5.0 + 0.01 * k, REST | later)
    assert (trip.name, trip.axis, trip.distrusted) == (name, ("legs", 2), distrusted)
    assert trip.sign.startswith(words)
    axes = {"legs": ("leg 1", "leg 2", "leg 3", "leg 4")}
    assert str(Tripped(trip, axes)).startswith(f"{name}: leg 3 {words}")


@pytest.mark.parametrize(("allowed", "limit"), [(0.0, 0.06), (0.02, 0.06), (0.08, 0.08)])
def test_measurements_may_be_as_old_as_usual_or_as_is_allowed(allowed, limit):
    for age, name in (
        (limit - 0.005, None),
        (limit + 0.005, "legs_stale"),
        (np.nan, "legs_stale"),
    ):
        guard = PlainGuard(0.01, LIMITS)
        assert guard.allow_age(allowed) == 0.06
        values = {AGE: np.array([age]), POSITION: np.zeros(4)}
        trips = [guard.check(5.0 + 0.01 * k, values) for k in range(20)]
        assert (trips[-1].name if trips[-1] else None) == name


def test_a_tripped_job_says_its_reason_and_its_sign():
    trip = Trip("encoder_jump", "a leg that jumps", ("legs",))
    assert str(Tripped(trip)) == "encoder_jump: a leg that jumps; the job has been ended"
