"""The watchdog timer of an NI card, which opens the relay when no program resets it in time."""

import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from typing import Any

from parapod.systems.core.extras import need
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
    """

    def __init__(
        self,
        settings: NiDaqSettings,
        standing: Callable[[], AbstractContextManager[None]],
        options: Callable[[str], Any],
    ):
        """Creates it; nothing is opened.

        Args:
            settings: card, line of the relay, and timeout.
            standing: context that tells the driver library's errors as those of the device.
            options: gRPC options of a task by its name; None for a card in this computer.
        """
        self._settings, self._told, self._options = settings, standing, options
        self._errors, self._constants = need("nidaqmx.errors"), need("nidaqmx.constants")
        self._module, self._types = need("nidaqmx.system.watchdog"), need("nidaqmx.types")
        # One that is left armed, because its card cannot be reached, is left so on purpose.
        warnings.filterwarnings("ignore", category=self._errors.DaqResourceWarning)
        self._task: Any = None

    def take_over(self) -> bool:
        """Ends what another program has left; says whether its watchdog had expired.

        A card without a watchdog has nothing to end.
        """
        with self._told():
            try:
                task = self._made(_ANY)
            except self._errors.Error as error:
                # Either the driver refuses, or the server does not know watchdogs.
                code = getattr(error, "rpc_code", None)
                if getattr(code, "name", "UNIMPLEMENTED") != "UNIMPLEMENTED":
                    raise
                return False
            has_expired = self._has_expired(task)
            with suppress(self._errors.DaqError):
                task.clear_expiration()
            task.close()
        return has_expired

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
        with self._told():
            self._task = self._made(self._settings.watchdog_timeout)
            low = self._constants.Level.LOW
            self._task.cfg_watchdog_do_expir_states(
                [self._types.DOExpirationState(self._settings.relay, low)]
            )

    def arm(self) -> None:
        """Starts the timer."""
        with self._told():
            self._task.start()

    def reset(self) -> None:
        """Starts the timer anew.

        Raises:
            WatchdogExpired: it has run out.
        """
        with self._told():
            self._task.reset_timer()

    def disarm(self) -> None:
        """Stops the timer and unlocks the line, which stays low until it is written."""
        with self._told():
            self._task.clear_expiration()
            self._task.stop()

    def close(self) -> None:
        """Gives it back, which disarms it; never raises."""
        if self._task is not None:
            with suppress(Exception):
                self._task.close()
        self._task = None

    def _made(self, timeout: float) -> Any:
        device = self._settings.device
        name = f"parapod_{device}_watchdog"
        return self._module.WatchdogTask(device, name, timeout, self._options(name))
