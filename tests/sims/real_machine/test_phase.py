"""Ticks of a loop beside measurements that come by themselves."""

import math
from types import SimpleNamespace as Fields

import numpy as np
import pytest

from parapod.sims.real_machine.phase import Phase

PERIOD = 0.01
LEAD = 0.3 * PERIOD


def thread(stamp, sends_every=PERIOD, error=None, is_asked=False):
    device = Fields(is_asked=is_asked, sends_every=sends_every)
    return Fields(device=device, sample=Fields(stamp=stamp), error=error)


@pytest.mark.parametrize("count", [1, 2, 10])
@pytest.mark.parametrize("age", np.linspace(0.0, 0.0099, 12))
def test_a_tick_is_late_for_what_came_longer_ago_than_the_lead(age, count):
    # Its interval is a measured one, which is never a whole part of the period.
    every = PERIOD / count
    late = Phase([thread(50.0, 1.01 * every)], PERIOD).late(50.0 + 3 * PERIOD + age)
    assert -0.5 * every <= late <= 0.5 * every
    # A tick that much earlier comes the lead after a measurement.
    periods = (age - late - 0.3 * every) / every
    assert periods == pytest.approx(round(periods), abs=1e-6)


def test_nothing_is_shifted_without_measurements_that_come_in_the_period_of_the_loop():
    others = [
        thread(50.0, is_asked=True),
        thread(50.0, math.inf),
        thread(50.0, 0.0),  # two came at one instant
        thread(50.003, 0.7 * PERIOD),
        thread(50.003, 3 * PERIOD),
        thread(50.0, error="silent"),
    ]
    phase = Phase(others, PERIOD)
    assert all(phase.shift(50.0 + at) == 0.0 for at in np.linspace(0.0, 0.01, 7))


def test_of_several_parts_the_oldest_measurement_is_as_young_as_can_be():
    generator = np.random.default_rng(1)
    ticks = 60.0 + np.linspace(0.0, PERIOD, 2001)
    compared = 0
    for _ in range(50):
        stamps = 50.0 + PERIOD * generator.uniform(size=3)
        ages = (ticks[:, None] - stamps) % PERIOD
        # Each has come as long before as it must, or the tick may go by the one before it.
        admissible = ages.min(axis=1) >= LEAD
        if not admissible.any():
            continue
        compared += 1
        best = ages[admissible].max(axis=1).min()
        late = Phase([thread(stamp) for stamp in stamps], PERIOD).late(60.0)
        found = (60.0 - late - stamps) % PERIOD
        assert found.min() == pytest.approx(LEAD, abs=1e-9)
        assert found.max() == pytest.approx(best, abs=1e-5)
    assert compared > 20


@pytest.mark.parametrize("drift", [-1e-3, 0.0, 1e-3])
def test_ticks_follow_a_clock_that_goes_otherwise_and_a_sender_that_is_late_at_times(drift):
    generator = np.random.default_rng(2)
    sender = thread(0.0)
    phase, tick, ages = Phase([sender], PERIOD), 0.0075, []
    for _ in range(4000):
        k = math.floor(tick / (PERIOD * (1.0 + drift)))
        # Each comes up to 2 ms late, and one of twenty 8 ms.
        sent = k * PERIOD * (1.0 + drift)
        delay = 0.008 if generator.uniform() < 0.05 else 0.002 * generator.uniform()
        sender.sample.stamp = sent + min(delay, tick - sent)
        ages.append(tick - sent)
        shift = phase.shift(tick)
        assert abs(shift) <= 2e-3 * PERIOD
        tick += PERIOD + shift
    # Half of them come more than a millisecond late.
    assert max(np.abs(np.array(ages[1500:]) - LEAD - 0.001)) < 0.1 * PERIOD
