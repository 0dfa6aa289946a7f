"""The time by which devices and their controllers go: the computer's own, or an emulated one.

Real devices know the computer's clock only. Emulated devices and the program that drives them may
share another one (`EmulatedClock`), which runs at a rate and waits for programs that are late: so
the path to the hardware can be walked on any computer, however slow or busy it is.

Everything that belongs to a machine (periods, ages, watchdogs, heartbeats) goes by `monotonic`,
`sleep` and `wait`. Waits for answers are limited by an `answer_time`, of the computer's clock: a
device that is emulated and well answers, however late it is on a busy computer.
"""

import math
import mmap
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from weakref import WeakValueDictionary

# Name of the clock's file, beside the emulator's wires; there while an emulator keeps one.
CLOCK = "clock"

# Cells of the file: an even count while the rest is whole; the computer's time and the emulated
# one at an instant; the rate; emulated time minus that of calendars; how much was waited for
# physics and for controllers; whether a device misbehaves. Holds follow: their end, when the
# computer's clock overrules it, and the process.
_COUNT, _REAL, _EMULATED, _RATE, _CALENDAR, _PHYSICS, _CONTROLLERS, _UNWELL, _FIRST = range(9)
_HOLDS = 16
_WIDTH = 3  # cells of a hold
_SIZE = 8 * (_FIRST + _WIDTH * _HOLDS)
# The shortest sleep while the emulated time may stand still [s].
_LOOK = 5e-4
# Pause after a look at cells that are being written [s], and number of looks: a keeper that was
# killed in the middle never finishes.
_COLLISION, _COLLISIONS = 5e-5, 2000
# A process for which so much has been waited is asked whether it lives [s].
_SUSPICIOUS = 0.02
# A thread that sleeps may wake so much later [s].
_WAKING = 2e-3
# Longest wait for a program that is late, of the computer's clock [s]; a program that waits for a
# processor for so long does not run.
PATIENCE = 10.0
# Emulated devices are programs that wait for a processor: answers may take so much longer [-], and
# while all devices are well this share of the patience, so that an answer that does not come is
# told of while time still stands [-].
_LENIENCE, _ANSWERING = 10.0, 0.8


class Hold:
    """Time at which the emulated clock waits for a thread; with real devices it does nothing.

    Attributes:
        is_kept: true if there is a clock that waits.
    """

    is_kept = False

    def until(self, at: float) -> None:
        """Lets no later time come before the next call.

        Args:
            at: emulated time [s]; infinite: any may come.
        """

    def sleeping(self, until: float) -> None:
        """Lets the time come to which its own thread sleeps [s]."""

    @property
    def is_free(self) -> bool:
        """True while any time may come."""
        return True


class _SharedHold(Hold):
    """A hold in the cells of a clock."""

    is_kept = True

    def __init__(self, cells: "memoryview[float]", index: int, patience: float):
        self._cells, self._patience = cells, patience
        self._at = _FIRST + _WIDTH * index
        cells[self._at + 2] = float(os.getpid())

    def until(self, at: float) -> None:
        """See `Hold`."""
        self._cells[self._at + 1] = time.monotonic() + self._patience
        self._cells[self._at] = at

    def sleeping(self, until: float) -> None:
        """See `Hold`."""
        if self._cells[self._at] < until:
            self.until(until + _WAKING)

    @property
    def is_free(self) -> bool:
        """See `Hold`."""
        return math.isinf(self._cells[self._at])


class EmulatedClock:
    """A time that several programs share, in a file that they map.

    It runs `rate` times as fast as the computer's clock, until the first hold: the physics' next
    step, a controller's next tick, a device's next reading. There it stands still until that has
    been done, or has kept all programs waiting for too long. The wait is lost to all alike, and
    counted.

    One program keeps the clock, the others follow it.

    Attributes:
        rate: emulated seconds in one of the computer's [-]; 1 at most.
    """

    def __init__(self, path: Path, rate: float | None = None):
        """Opens the clock.

        Args:
            path: path of the file.
            rate: makes the file, and a clock of this rate that shows the computer's time now; None
                to follow one.

        Raises:
            FileNotFoundError: there is no clock to follow.
        """
        if rate is not None:
            fresh = path.with_name(f"{path.name}.new")
            fresh.write_bytes(bytes(_SIZE))
            fresh.replace(path)
        with open(path, "r+b") as file:
            self._memory = mmap.mmap(file.fileno(), _SIZE)
        self._cells = memoryview(self._memory).cast("d")
        self._lock, self._last = threading.Lock(), 0.0
        self._holds: WeakValueDictionary[int, _SharedHold] = WeakValueDictionary()
        if rate is not None:
            now = time.monotonic()
            for k in range(_HOLDS):
                self._cells[_FIRST + _WIDTH * k] = math.inf
            self._cells[_CALENDAR] = time.time() - now
            self._set(now, now, rate)
        self.rate = self._cells[_RATE]

    @property
    def calendar(self) -> float:
        """Time of calendars minus the emulated one, when the clock was made [s]."""
        return self._cells[_CALENDAR]

    @property
    def waited(self) -> tuple[float, float]:
        """Emulated time that was waited for the physics, and for controllers [s]."""
        return self._cells[_PHYSICS], self._cells[_CONTROLLERS]

    def now(self) -> float:
        """The emulated time [s]; it shows the computer's monotonic one when the clock is made."""
        now = max(self._shown(time.monotonic())[0], self._last)
        self._last = now
        return now

    @property
    def is_well(self) -> bool:
        """True while all emulated devices behave, and so answer sooner or later."""
        return self._cells[_UNWELL] == 0.0

    @is_well.setter
    def is_well(self, is_well: bool) -> None:
        self._cells[_UNWELL] = 0.0 if is_well else 1.0

    def hold(self, patience: float = PATIENCE) -> Hold:
        """A new hold of this program's, which does nothing if too many threads have one.

        Args:
            patience: time of the computer's clock for which everybody waits at most [s].
        """
        with self._lock:
            free = [k for k in range(1, _HOLDS) if k not in self._holds]
            if not free:
                return Hold()
            self._holds[free[0]] = shared_hold = _SharedHold(self._cells, free[0], patience)
        return shared_hold

    def release(self) -> None:
        """Lets go of all holds but the physics': the controller that had them has ended."""
        for k in range(1, _HOLDS):
            self._cells[_FIRST + _WIDTH * k] = math.inf

    def keeper(self, patience: float = PATIENCE) -> Hold:
        """The hold of the calling thread of the program that keeps the clock.

        Args:
            patience: see `hold` [s].
        """
        _thread.hold, _thread.clock = _Keeper(self, patience), self
        return _thread.hold

    def _advance(self) -> None:
        """Goes on from here: what was waited for until now is lost, and counted."""
        real = time.monotonic()
        emulated_now, free, holder = self._shown(real)
        if free > emulated_now:
            self._cells[_PHYSICS if holder == 0 else _CONTROLLERS] += free - emulated_now
            self._set(real, emulated_now, self.rate)

    def _set(self, real: float, emulated: float, rate: float) -> None:
        cells = self._cells
        cells[_COUNT] += 1.0
        cells[_REAL], cells[_EMULATED], cells[_RATE] = real, emulated, rate
        cells[_COUNT] += 1.0

    def _shown(self, real: float) -> tuple[float, float, int]:
        """Emulated time, the one without any holds, and the hold that keeps it back; or -1."""
        for _ in range(_COLLISIONS):
            cells = self._cells.tolist()
            if cells[_COUNT] % 2.0 == 0.0 and self._cells[_COUNT] == cells[_COUNT]:
                break
            time.sleep(_COLLISION)  # a real-time reader would keep the writer away
        free = emulated_now = cells[_EMULATED] + cells[_RATE] * (real - cells[_REAL])
        holder = -1
        for k in range(_HOLDS):
            end = cells[_FIRST + _WIDTH * k]
            if end < emulated_now and real < cells[_FIRST + _WIDTH * k + 1]:
                emulated_now, holder = end, k
        if free - emulated_now > _SUSPICIOUS and not _lives(
            int(cells[_FIRST + _WIDTH * holder + 2])
        ):
            self._cells[_FIRST + _WIDTH * holder] = math.inf
        return max(emulated_now, cells[_EMULATED]), free, holder


class _Keeper(_SharedHold):
    """The hold of the physics; a time that stood still goes on from there."""

    def __init__(self, clock: EmulatedClock, patience: float):
        super().__init__(clock._cells, 0, patience)
        self._clock = clock

    def until(self, at: float) -> None:
        """See `Hold`."""
        self._clock._advance()
        super().until(at)


_clock: EmulatedClock | None = None


@contextmanager
def going_by(clock: EmulatedClock | None) -> Iterator[None]:
    """Has this program go by a clock while it lasts; None: the computer's."""
    global _clock
    before, _clock = _clock, clock
    try:
        yield
    finally:
        _clock = before


@contextmanager
def following(path: Path) -> Iterator[EmulatedClock | None]:
    """Follows the clock of an emulator while it lasts, if it keeps one.

    Args:
        path: path of its file.

    Yields the clock, or None.
    """
    try:
        clock = EmulatedClock(path)
    except FileNotFoundError:
        clock = None
    with going_by(clock):
        yield clock


def monotonic() -> float:
    """The time of devices [s]; without an emulated clock `time.monotonic`."""
    return time.monotonic() if _clock is None else _clock.now()


def calendar_time_ns() -> int:
    """The time of devices as calendars have it, for logs [ns]."""
    if _clock is None:
        return time.time_ns()
    return round(1e9 * (_clock.calendar + _clock.now()))


def sleep(seconds: float) -> None:
    """Waits until a time has passed for devices [s]."""
    if _clock is None:
        time.sleep(seconds)
        return
    until = _clock.now() + seconds
    while (time_left := until - _clock.now()) > 0.0:
        _thread.hold.sleeping(until)  # again: a loop that posts a command sets the hold meanwhile
        time.sleep(computer_time(time_left))


def wait(event: threading.Event, seconds: float) -> bool:
    """Waits for an event until a time has passed for devices; whether it came.

    Args:
        event: the event.
        seconds: [s].
    """
    return event.wait(seconds) if _clock is None else wait_until(event, _clock.now() + seconds)


def wait_until(event: threading.Event, at: float) -> bool:
    """Waits for an event until a time of devices; whether it came.

    Args:
        event: the event.
        at: instant by `monotonic` [s].
    """
    if _clock is None:
        return event.wait(max(0.0, at - time.monotonic()))
    _thread.hold.sleeping(at)
    while (time_left := at - _clock.now()) > 0.0:
        if event.wait(computer_time(time_left)):
            return True
    return event.is_set()


def answer_time(seconds: float) -> float:
    """Time of the computer's clock for an answer that is due within a time of the device's [s]."""
    if _clock is None:
        return seconds
    lenient = search_time(seconds)
    return max(lenient, _ANSWERING * PATIENCE) if _clock.is_well else lenient


@contextmanager
def awaiting_answer(seconds: float) -> Iterator[float]:
    """Has an answer that stays away take as long for devices as it does on the real machine.

    An emulated time goes no further than that while the block waits, and goes as far if it waits
    in vain, whatever held it before.

    Args:
        seconds: time of the device's within which the answer is due [s].

    Yields `answer_time` of it [s].
    """
    longest = answer_time(seconds)
    if _clock is None:
        yield longest
        return
    began, until, own_hold = time.monotonic(), _clock.now() + seconds, hold()
    if was_free := own_hold.is_free:
        own_hold.until(until)
    try:
        yield longest
    finally:
        if time.monotonic() - began >= longest:
            sleep(until - _clock.now())
        if was_free:
            own_hold.until(math.inf)


def search_time(seconds: float) -> float:
    """Time of the computer's clock for devices that may be there, to answer within theirs [s]."""
    return seconds if _clock is None else _LENIENCE * seconds / _clock.rate


def computer_time(seconds: float) -> float:
    """Time of the computer's clock after which that of devices may be so much further [s]."""
    return seconds if _clock is None else max(seconds / _clock.rate, _LOOK)


def hold(patience: float = PATIENCE) -> Hold:
    """The hold of the calling thread, see `EmulatedClock.hold`; its own sleep does not wait."""
    if _thread.clock is not _clock:
        _thread.hold, _thread.clock = Hold() if _clock is None else _clock.hold(patience), _clock
    return _thread.hold


@contextmanager
def standing_still() -> Iterator[None]:
    """Keeps an emulated time from going on while the calling thread works, but for its sleep."""
    own_hold = hold()
    own_hold.until(monotonic())
    try:
        yield
    finally:
        own_hold.until(math.inf)


def _lives(process: int) -> bool:
    """Whether a process has not ended; those that are stopped live."""
    try:
        os.kill(process, 0)
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except ProcessLookupError:
        return False
    except OSError:  # another user's, or elsewhere than on Linux
        return True
    return state not in "ZX"


class _Thread(threading.local):
    hold = Hold()
    clock: EmulatedClock | None = None


_thread = _Thread()
