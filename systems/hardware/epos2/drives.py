"""Velocity-controlled axes: Maxon motors on EPOS2 24/5 controllers on a CANopen bus."""

import time
from collections.abc import Callable, Sequence

from parapod.systems.hardware.ds402 import Controlword
from parapod.systems.hardware.epos2.controller import Timing
from parapod.systems.hardware.epos2.device import Epos2Device
from parapod.systems.hardware.epos2.settings import Epos2Settings


class Epos2(Epos2Device):
    """Velocity-controlled axes in profile velocity mode; see also `Epos2Device`.

    | signal | size | unit | meaning |
    |---|---|---|---|
    | command `velocity_command` | n | rad/s or m/s | of the axes |

    **Limits.** With limits nothing moves before there is a reference, and no command, however
    wild, drives an axis out of them: see `SoftLimits`. They are kept at every command and at
    every reading, so also between two commands of a controller that hangs. Axes whose position
    has not been measured for the limits' `lead` are commanded zero, all of them if one node is
    silent or has a fault.
    """

    command_signal = "velocity_command"

    def __init__(
        self,
        settings: Epos2Settings,
        timing: Timing = Timing(),
        is_synchronous: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ):
        """See `Epos2Device`."""
        super().__init__(settings, timing, is_synchronous, clock)
        self._limits = settings.limits
        self._wanted: Sequence[float] = (0.0,) * len(settings.node_ids)
        # Velocities of the motors that have been sent; None: another controlword has.
        self._sent: list[int | None] | None = None

    def seek_reference(self) -> None:
        """See `Epos2Device`."""
        super().seek_reference()
        self._limits = None

    @property
    def _has_limits(self) -> bool:
        return self._limits is not None

    def _want(self, wanted: Sequence[float] | None) -> None:
        self._wanted = (0.0,) * len(self._directions) if wanted is None else wanted

    def _begin(self, settings: Sequence[int]) -> None:
        """Enabled at zero velocity, drives stand until the first command."""

    def _run(self) -> None:
        self._send(Controlword.ENABLE_OPERATION, self._targets())

    def _send(self, word: Controlword, settings: Sequence[int] = ()) -> None:
        # Who knows how many of them have been sent if that fails?
        self._sent = [None] * len(settings) if settings else None
        super()._send(word, settings)
        if settings:
            self._sent = [*settings]

    def _restrain(self) -> None:
        """Slows down axes that have come closer to a limit since they were commanded."""
        if self._limits is None or self._sent is None:
            return
        targets = self._targets()
        for i, (controller, target) in enumerate(zip(self._controllers, targets, strict=True)):
            if target != self._sent[i]:
                controller.steer(target)
                self._sent[i] = target

    def _targets(self) -> list[int]:
        """Velocities of the motors [rpm] for those that are wanted of the axes."""
        velocities = self._wanted
        if (limits := self._limits) is not None:
            is_known = self._clock() - self._measured <= limits.lead
            allowed = limits.allowed(velocities, self._position)
            velocities = allowed if is_known else [0.0] * len(allowed)
        pairs = zip(velocities, self._directions, strict=True)
        return [sign * self._settings.rpm(velocity) for velocity, sign in pairs]
