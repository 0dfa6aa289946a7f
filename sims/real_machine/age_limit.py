"""Largest age of measurements that a job goes by, as this computer and its devices allow."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

from pydrake.systems.framework import Context, Diagram

from parapod.diagrams.guard import Guard
from parapod.diagrams.wiring import leaf_systems
from parapod.sims.real_machine.real_time import DeadlineError
from parapod.systems.hardware.clock import hold, monotonic, sleep
from parapod.systems.hardware.io import STALE_AFTER, DeviceThread

# How long it is looked at ages, and how much of that threads need until they read in time [s].
LOOKED, _SETTLING = 0.5, 0.1
# How much older measurements may become within a job [-]; limits are multiples of a time [s].
_MARGIN, _GRID = 2.0, 0.01
# An emulated time waits for looks that are so late [periods].
_SLACK = 0.1


class Ages(NamedTuple):
    """Ages of measurements, had a loop taken them.

    Attributes:
        oldest: largest age [s].
        late: largest delay with which the loop woke up [s].
    """

    oldest: float
    late: float


def ages_of(
    threads: Sequence[DeviceThread],
    period: float,
    clock: Callable[[], float] = monotonic,
    sleep: Callable[[float], None] = sleep,
) -> Ages:
    """Takes samples as a loop does, for half a second, and commands nothing.

    Args:
        threads: threads of the devices; a failed one is left to the watch of the devices.
        period: period of the loop [s].
        clock: clock of the threads [s].
        sleep: waits for a time of that clock [s].
    """
    standing, oldest, late = hold(), 0.0, 0.0
    started = due = clock()
    try:
        while due < started + LOOKED:
            due = max(due + period, clock())
            standing.until(due + _SLACK * period)
            sleep(max(0.0, due - clock()))
            stamps = [t.sample.stamp for t in threads if t.device.measures and not t.error]
            for thread in threads:
                thread.taken()
            now = clock()
            if now >= started + _SETTLING:
                oldest, late = max(oldest, now - min(stamps, default=now)), max(late, now - due)
    finally:
        standing.until(math.inf)
    return Ages(oldest, late)


def allow_old_measurements(
    diagram: Diagram,
    root: Context,
    guard: Guard | None,
    look: Callable[[], Ages],
    say: Callable[[str], None],
) -> None:
    """Raises the limits of age of all that watches it, where this computer needs that.

    A limit is twice the largest age that is seen, if that is more than the usual one, and at most
    0.1 s (`STALE_AFTER`). That is safe: measurements that are older are NaN, which no controller
    follows, and a controller that hangs is replaced by neutral outputs after the same time
    (`COMMAND_TIMEOUT`), so that no leg goes on unseen for longer than without any limit. At their
    fastest that are 12 mm of a leg of the platform, 8 mm of a branch of the chair and 15 mm of a
    leg of the machining centre; the bench's sliders are led by their drives meanwhile.

    What watches the age has a method `allow_age`, which is given the limit [s] and returns its
    usual one: systems that of their own context as well, guards nothing else.

    Args:
        diagram: its systems are asked.
        root: its context.
        guard: guard of the job, if there is one.
        look: gives the ages that there would be, see `ages_of`.
        say: called with a limit that is not the usual one.

    Raises:
        DeadlineError: measurements are too old for any limit, twice in a row.
    """
    ages = look()
    if ages.oldest > STALE_AFTER and (ages := look()).oldest > STALE_AFTER:
        raise DeadlineError(
            f"measurements would be up to {_ms(ages.oldest)} ms old when they are taken, and this "
            f"program wakes up to {_ms(ages.late)} ms late; above {_ms(STALE_AFTER)} ms no "
            "machine is driven"
        )
    limit = min(_GRID * math.ceil(_MARGIN * ages.oldest / _GRID - 1e-9), STALE_AFTER)
    hooks: list[Callable[[float], float]] = [
        partial(system.allow_age, system.GetMyMutableContextFromRoot(root))
        for system in leaf_systems(diagram)
        if hasattr(system, "allow_age")
    ]
    if guard is not None and hasattr(guard, "allow_age"):
        hooks.append(guard.allow_age)
    usual = min((allow(limit) for allow in hooks), default=limit)
    if limit > usual:
        say(
            f"measurements are up to {_ms(ages.oldest)} ms old on this computer: their limit of "
            f"age is {_ms(limit)} ms in place of {_ms(usual)}"
        )


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f}"
