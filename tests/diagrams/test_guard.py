"""Ticks of a loop that can be compared with the one before."""

from parapod.diagrams.guard import Ticks, Trip, Tripped


def test_a_tick_is_regular_a_period_after_the_one_before_and_at_most_half_of_one_off():
    ticks = Ticks(0.01)
    gaps = (0.0, 0.01, 0.0149, 0.0151, 0.0051, 0.0049, 0.01, 1.0, 0.01)
    now, regular = 100.0, []
    for gap in gaps:
        now += gap
        regular.append(ticks.is_regular(now))
    assert regular == [False, True, True, False, True, False, True, False, True]


def test_a_tripped_job_says_its_reason_and_its_sign():
    trip = Trip("encoder_jump", "a leg that jumps", ("legs",))
    assert str(Tripped(trip)) == "encoder_jump: a leg that jumps; the job has been ended"
