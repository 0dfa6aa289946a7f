"""Velocity-controlled axes: Maxon motors on EPOS2 24/5 controllers on a CANopen bus."""

from collections.abc import Callable

from parapod.systems.hardware.clock import monotonic
from parapod.systems.hardware.epos2.controller import Timing
from parapod.systems.hardware.epos2.settings import Epos2Settings
from parapod.systems.hardware.epos2.steered import Epos2Steered


class Epos2(Epos2Steered):
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

    def __init__(
        self,
        settings: Epos2Settings,
        timing: Timing = Timing(),
        is_synchronous: bool = True,
        clock: Callable[[], float] = monotonic,
    ):
        """See `Epos2Device`."""
        super().__init__(settings, timing, is_synchronous, clock)
        self._limits = settings.limits

    def seek_reference(self) -> None:
        """See `Epos2Device`."""
        super().seek_reference()
        self._limits = None

    @property
    def _has_limits(self) -> bool:
        return self._limits is not None

    def _targets(self) -> list[int]:
        """Velocities of the motors [rpm] for those that are wanted of the axes."""
        velocities = self._wanted
        if (limits := self._limits) is not None:
            is_known = self._clock() - self._measured <= limits.lead
            allowed = limits.allowed(velocities, self._position)
            velocities = allowed if is_known else [0.0] * len(allowed)
        pairs = zip(velocities, self._directions, strict=True)
        return [sign * self._settings.rpm(velocity) for velocity, sign in pairs]
