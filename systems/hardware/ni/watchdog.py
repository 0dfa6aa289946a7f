"""The watchdog timer of an NI card, which opens the relay when no program resets it in time."""

import math
import warnings
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from typing import Any

from parapod.systems.core.extras import need
from parapod.systems.hardware.clock import answer_time, monotonic
from parapod.systems.hardware.device import DeviceFault
from parapod.systems.hardware.ni.session import NiSession
from parapod.systems.hardware.ni.settings import NiDaqSettings

# Timeout of a task that only clears what another one has left [s]; it is never started.
_ANY = 10.0


class NiWatchdog:
    """A DAQmx watchdog task that guards the line of the relay.

    It runs in the card: once armed it needs neither this program nor its server. When it expires
    it sets the line low and locks it, and stays so when its program has ended; it is cleared by
    any watchdog task of the card (NI's example WriteDigChan-WatchdogTimer.c).

    X Series cards have it for digital lines only (X Series User Manual, "Watchdog Timer"; states
    of analog outputs are for a cDAQ-9185 or -9189): the analog outputs hold.

    Attributes:
        had_expired: true if that of an earlier program had opened the relay.
        is_armed: true while it guards the relay.
    """

    def __init__(self, session: NiSession[NiDaqSettings], pool: ThreadPoolExecutor | None):
        """Creates it; nothing is opened.

        Args:
            session: session with its card.
            pool: threads that wait for a server in place of the caller; None: without one.
        """
        self._session, self._settings, self._pool = session, session.settings, pool
        self._errors, self._constants = need("nidaqmx.errors"), need("nidaqmx.constants")
        # One that is left armed, because its card cannot be reached, is left so on purpose.
        warnings.filterwarnings("ignore", category=self._errors.DaqResourceWarning)
        self.had_expired = self.is_armed = False
        self._reset_at = -math.inf
        self._task: Any = None
        self._answer: Future[None] | None = None

    def take_over(self) -> None:
        """Ends what another program has left, and notes whether its watchdog had expired.

        A card without a watchdog has nothing to end.
        """
        with self._session.told():
            try:
                task = self._create(_ANY)
            except self._errors.Error as error:
                # Either the driver refuses, or the server does not know watchdogs.
                code = getattr(error, "rpc_code", None)
                if getattr(code, "name", "UNIMPLEMENTED") != "UNIMPLEMENTED":
                    raise
                return
            self.had_expired = self._has_expired(task)
            with suppress(self._errors.DaqError):
                task.clear_expiration()
            task.close()

    def _has_expired(self, task: Any) -> bool:
        """Whether the card's watchdog has, as far as a task knows."""
        with suppress(self._errors.DaqError):
            return bool(task.expired)  # it runs: a server has kept it
        with suppress(self._errors.DaqError):
            # Starting it would clear what is asked.
            task.control(self._constants.TaskMode.TASK_RESERVE)
            return bool(task.expired)
        return False

    def open(self) -> None:
        """Prepares it, disarmed.

        Raises:
            DeviceError: the card has none, or refuses it for this line.
        """
        with self._session.told():
            self._task = self._create(self._settings.watchdog_timeout)
            low, state = self._constants.Level.LOW, need("nidaqmx.types").DOExpirationState
            self._task.cfg_watchdog_do_expir_states([state(self._settings.relay, low)])

    def arm(self) -> None:
        """Starts the timer."""
        with self._session.told():
            self._task.start()
        self.is_armed, self._reset_at = True, monotonic()

    def reset(self, share: float) -> None:
        """Starts the timer of an armed one anew if that is due.

        A server is not waited for.

        Args:
            share: share of the timeout after which it is due.

        Raises:
            WatchdogExpired: it has run out. Through a server the next call says so.
        """
        now = monotonic()
        if not self.is_armed or now < self._reset_at + share * self._settings.watchdog_timeout:
            return
        if self._pool is None:
            self._reset()
        elif self._answer is None or self._answer.done():
            error = None if self._answer is None else self._answer.exception()
            self._answer = None
            # Calls that did not arrive are named by those that are waited for.
            if error and getattr(error, "fault", DeviceFault.FAILED) is DeviceFault.FAILED:
                raise error
            self._answer = self._pool.submit(self._reset)
        self._reset_at = now

    def _reset(self) -> None:
        with self._session.told():
            self._task.reset_timer()

    def disarm(self) -> None:
        """Stops the timer and unlocks the line, which stays low until it is written."""
        if self._answer is not None:
            wait([self._answer], answer_time(self._session.waits))
            self._answer = None
        with self._session.told():
            self._task.clear_expiration()
            self._task.stop()
        self.is_armed = False

    def close(self) -> None:
        """Gives it back unless it is armed, for then it is to open the relay; never raises."""
        if self._task is not None and not self.is_armed:
            with suppress(Exception):
                self._task.close()
        self._task = None

    def _create(self, timeout: float) -> Any:
        device = self._settings.device
        name = f"parapod_{device}_watchdog"
        task = need("nidaqmx.system.watchdog").WatchdogTask
        return task(device, name, timeout, self._session.options(name))
