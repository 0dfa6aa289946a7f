"""Velocity-controlled axes, and what they share with axes whose forces are commanded."""

import math
from abc import abstractmethod
from collections.abc import Sequence

from parapod.systems.core.elementwise import clamp
from parapod.systems.hardware.cia402 import objects
from parapod.systems.hardware.cia402.device import LONGEST, Cia402Device
from parapod.systems.hardware.cia402.set_up import mode_of
from parapod.systems.hardware.cia402.settings import AxesSettings
from parapod.systems.hardware.cia402.states import Controlword


class Steered(Cia402Device):
    """Axes that are commanded zero to stay where they are, and limited by what is measured.

    Set values follow from what is commanded and from the newest measurements. They are sent at
    every command, and a reading that asks for others sends these at once: so also between two
    commands of a controller that hangs.
    """

    # Set values that have been sent; None: another controlword has.
    _sent: list[int | None] | None = None

    def _run(self) -> None:
        self._send(Controlword.ENABLE_OPERATION, self._targets())

    @property
    def _desired(self) -> Sequence[float]:
        """Newest command; zeros for axes that are to stay where they are."""
        return (0.0,) * len(self._directions) if self._wanted is None else self._wanted

    def _send(
        self, word: Controlword, settings: Sequence[int] = (), offsets: Sequence[int] = ()
    ) -> None:
        # If sending fails midway, all are sent again.
        self._sent = [None] * len(settings) if settings else None
        super()._send(word, settings, offsets)
        if settings:
            self._sent = [*settings]

    def _restrain(self) -> None:
        """Sends axes other set values, where those that were sent are not allowed any more."""
        if self._sent is None:
            return
        targets = self._targets()
        for i, (controller, target) in enumerate(zip(self._controllers, targets, strict=True)):
            if target != self._sent[i]:
                controller.steer(target)
                self._sent[i] = target

    @abstractmethod
    def _targets(self) -> list[int]:
        """Set values of the motors for desired motions of the axes, within the limits."""


class Cia402Velocities(Steered):
    """Axes whose velocities are commanded; see also `Cia402Device`.

    | signal | size | unit | meaning |
    |---|---|---|---|
    | command `velocity_command` | n | rad/s or m/s | of the axes |

    In profile velocity mode (3) the drives follow a command on a ramp. Cyclic synchronous velocity
    mode (9) has none, and the driver leads the set values on the same ramp; a pause between two
    calls counts for 20 ms at most.

    **Limits.** With limits nothing moves before there is a reference, and no command, however
    wild, drives an axis out of them: see `SoftLimits`. They are kept at every command and at
    every reading, so also between two commands of a controller that hangs. Axes whose position
    has not been measured for the limits' `lead` are commanded zero, all of them if one node is
    silent or has a fault.
    """

    def _adopt(self, settings: AxesSettings) -> None:
        super()._adopt(settings)
        self._limits = None if self._is_homing else settings.limits
        self._has_limits = self._limits is not None
        # Velocities of the axes that a ramp of ours has led to, and since when.
        self._led = [0.0] * len(settings.node_ids)
        self._leads, self._led_at = mode_of(settings) is objects.CYCLIC_VELOCITY, -math.inf

    def _targets(self) -> list[int]:
        """Velocities of the motors for those that are wanted of the axes, in the drives' unit."""
        velocities = self._desired
        if (limits := self._limits) is not None:
            is_known = self._clock() - self._measured <= limits.lead
            allowed = limits.allowed(velocities, self._position)
            velocities = allowed if is_known else [0.0] * len(allowed)
        if self._leads:
            velocities = self._ramped(velocities)
        axes = zip(self._controllers, velocities, self._directions, strict=True)
        return [drive.speed(sign * self._settings.rpm(v)) for drive, v, sign in axes]

    def _ramped(self, velocities: Sequence[float]) -> Sequence[float]:
        """Velocities on the way to those that are wanted."""
        now, fastest = self._clock(), self._settings.max_velocity
        step = self._settings.acceleration * min(now - self._led_at, LONGEST)
        before = self._led if self._sent is not None else self._velocity
        finite = [v if math.isfinite(v) else 0.0 for v in velocities]
        goals = [float(clamp(v, -fastest, fastest)) for v in finite]
        pairs = zip(goals, before, strict=True)
        self._led = [was + float(clamp(goal - was, -step, step)) for goal, was in pairs]
        self._led_at = now
        return self._led
