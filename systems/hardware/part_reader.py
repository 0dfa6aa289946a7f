"""What the devices of one part of a machine have measured, as output ports."""

import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from pydrake.systems.framework import Context, LeafSystem, State

from parapod.systems.hardware.device import DeviceFault
from parapod.systems.hardware.io_thread import DeviceThread

# Measurements that are older than this are shown as NaN, which no controller follows [s].
STALE_AFTER = 0.1


class PartReader(LeafSystem):
    """Takes the newest samples of the devices of one part, all at one instant of the loop.

    | port | size | unit | meaning |
    |---|---|---|---|
    | out `age` | 1 | s | time since the oldest sample of the part was begun |
    | out `fault` | 1 | code | the first device's `DeviceFault`; 0: none |
    | out `stamp` | 1 | s | `time.monotonic` when the oldest sample was begun |

    Besides, one output for each signal that a device measures, with its name, size and SI unit.

    State: discrete, every port's value, taken in a periodic unrestricted update at offset 0: the
    controllers' discrete updates of the same instant see it. Nothing here waits for a device: its
    thread does.

    Bad input: signals that are older than `stale_after` are NaN until there are newer ones; age
    and fault tell why.
    """

    def __init__(
        self,
        part: str = "part",
        threads: Sequence[DeviceThread] = (),
        period: float = 0.01,
        stale_after: float = STALE_AFTER,
        clock: Callable[[], float] = time.monotonic,
    ):
        """Creates the system; its ports follow from what the devices measure.

        Args:
            part: name of the part.
            threads: of its devices; none for a part without.
            period: of the loop [s].
            stale_after: see the class [s].
            clock: that of the threads [s].
        """
        super().__init__()
        self.set_name(f"{part}_reader")
        self._threads, self._clock, self._stale_after = tuple(threads), clock, stale_after
        self._signals: list[tuple[DeviceThread, str, int]] = []
        for thread in self._threads:
            for signal, size in thread.device.measures.items():
                self._declare(signal, size)
                self._signals.append((thread, signal, size))
        for name in ("age", "fault", "stamp"):
            self._declare(name, 1)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update_samples)

    def _declare(self, name: str, size: int) -> None:
        self.DeclareStateOutputPort(name, self.DeclareDiscreteState(size))

    def reset(self, context: Context) -> None:
        """Puts the newest samples into a context, so that a loop begins with measurements.

        Raises:
            DeviceError: a device has a fault.
        """
        for thread in self._threads:
            if (error := thread.error) is not None:
                raise error
        for index, values in enumerate(self._taken()):
            context.SetDiscreteState(index, values)

    def _update_samples(self, context: Context, state: State) -> None:
        discrete = state.get_mutable_discrete_state()
        for index, values in enumerate(self._taken()):
            discrete.set_value(index, values)

    def _taken(self) -> list[np.ndarray]:
        """The values of all ports."""
        samples = {id(thread): thread.sample for thread in self._threads}
        for thread in self._threads:
            thread.taken()
        now = self._clock()
        values = []
        for thread, signal, size in self._signals:
            sample = samples[id(thread)]
            fresh = now - sample.stamp <= self._stale_after
            shown = sample.values.get(signal) if fresh else None
            values.append(np.full(size, math.nan) if shown is None else np.array(shown))
        measuring = [samples[id(thread)] for thread in self._threads if thread.device.measures]
        stamp = min((sample.stamp for sample in measuring), default=now)
        fault = next((s.fault for s in samples.values() if s.fault), DeviceFault.NONE)
        return [*values, np.array([now - stamp]), np.array([float(fault)]), np.array([stamp])]
