"""Moments as people and programs read them."""

import time


def moment(seconds: float | None = None) -> str:
    """A moment as in "2026-03-09 14:05:00 UTC".

    Args:
        seconds: time since the beginning of 1970 [s]; None: now.
    """
    return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(seconds))
