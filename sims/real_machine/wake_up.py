"""A loop that only wakes up: how late a computer is by itself."""

import time
from collections.abc import Iterator
from itertools import islice


def wake_ups(period: float) -> Iterator[tuple[float, float]]:
    """Wakes up once a period, for ever; yields when that was due and when it was, monotonic [s].

    Args:
        period: [s].
    """
    due = time.monotonic()
    while True:
        due += period
        while (time_left := due - time.monotonic()) > 0.0:
            time.sleep(time_left)
        now = time.monotonic()
        yield due, now
        due = max(due, now - period)


def wake_up_latency(period: float, duration: float) -> list[float]:
    """Delays of a thread that wakes up once a period [s], as cyclictest measures them.

    Args:
        period: [s].
        duration: for which it does [s].
    """
    return [now - due for due, now in islice(wake_ups(period), round(duration / period))]
