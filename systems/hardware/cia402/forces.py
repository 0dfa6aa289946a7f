"""Axes whose forces or torques are commanded, by the currents of their motors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from parapod.systems.core.elementwise import clamp
from parapod.systems.hardware.cia402.controller import STANDSTILL
from parapod.systems.hardware.cia402.settings import AxesSettings
from parapod.systems.hardware.cia402.states import Controlword
from parapod.systems.hardware.cia402.velocities import Steered
from parapod.systems.hardware.device import DeviceError

# A measurement that is older tells nothing about where an axis is and how fast [s]: five periods
# at 100 Hz.
_FRESH = 0.05
# From this share of the largest velocity on the force in its direction falls, to zero at it.
_FALLING = 0.9


@dataclass(frozen=True)
class ForceLimits:
    """Forces, or torques, with which axes neither run away nor are pushed out of their ends.

    Attributes:
        lower: (n) least positions [m or rad].
        upper: (n) largest positions [m or rad].
        lead: time ahead for which an axis, at its velocity, must still be within them [s].
        max_velocity: largest velocity [m/s or rad/s].
        max_force: largest force or torque [N or N m].
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    lead: float
    max_velocity: float
    max_force: float

    def allowed(
        self, forces: Sequence[float], positions: Sequence[float], velocities: Sequence[float]
    ) -> list[float]:
        """Forces (n) that are allowed [N or N m].

        Args:
            forces: (n) that are wanted; one that is not finite is 0.
            positions: (n) as measured [m or rad].
            velocities: (n) as measured [m/s or rad/s].
        """
        axes = zip(forces, positions, velocities, self.lower, self.upper, strict=True)
        return [self._within(f, v, x - low, high - x) for f, x, v, low, high in axes]

    def _within(self, force: float, velocity: float, below: float, above: float) -> float:
        """Force that is allowed on an axis at these distances from its ends."""
        if not (math.isfinite(force) and math.isfinite(velocity)):
            return 0.0
        limited = float(clamp(force, -self.max_force, self.max_force))
        # As if it were pushed upwards.
        way, speed = (above, velocity) if limited > 0.0 else (below, -velocity)
        if not min(way, way - self.lead * speed) > 0.0:  # NaN as well
            return 0.0
        share = (1.0 - speed / self.max_velocity) / (1.0 - _FALLING)
        return limited * float(clamp(share, 0.0, 1.0))


class Cia402Forces(Steered):
    """Axes whose forces, or torques, are commanded; see also `Cia402Device`.

    | signal | size | unit | meaning |
    |---|---|---|---|
    | command `force_command` or `torque_command` | n | N or N m | of the axes |

    The name of the command is that of the settings: `force_command` of slides, `torque_command`
    of axes that turn. The set value is a current in an EPOS2's current mode (-3), and in cyclic
    synchronous torque mode (10) of others thousandths of the rated torque, which are those of the
    rated current here; the settings say what force a current makes.
    That is the motor's: friction, and the weight of what it moves, are not taken off. A command
    that is not finite is zero, one beyond the largest force is that. A controlword that stops a
    drive comes with a set value of zero.

    **Nothing holds.** Without a force an axis is free, and a drive in this mode brakes nothing.
    What moves then coasts, and what hangs falls, unless a mechanical brake or a balancer holds it.
    A slide that is not horizontal needs a power-off brake, such as at the drive's holding brake
    output, which closes when the drive has no power. So `brake` and `neutral` take the power
    (switched on, operation disabled), and so do the emergency stop, a lost heartbeat and a fault;
    `deactivate` does not wait for a standstill. `activate` gives no power yet: a command without
    `brake` does, together with its force.

    **Ends.** Where there are ends nothing gets power before there is a reference. An axis that is
    beyond an end, or would be after the settings' `limit_lead_ms` at its velocity, is pushed
    inwards only. That does not stop it: it coasts to the machine's own stops.

    **Largest velocity.** The force in the direction in which an axis moves falls linearly from
    nine tenths of `max_velocity_rpm` on, and is zero at it and beyond; forces against the motion
    stay. So an axis that has lost its load does not run away. The drives have the same
    velocity, where they know one.

    Ends and largest velocity are kept at every command and at every reading, so also between two
    commands of a controller that hangs.

    **Silence.** Without a new measurement for 50 ms forces are zero, those of all axes if one
    node is silent.

    **Memory.** A file that keeps the positions of slides is right only where a brake holds them
    without power. One that moves on without it is an error of `deactivate`, and the file knows
    nothing, until it stands and `deactivate` is called again.
    """

    _holds, _braking = False, Controlword.SWITCH_ON

    def _adopt(self, settings: AxesSettings) -> None:
        super()._adopt(settings)
        possible = settings.current_limit_a * settings.force_per_current
        if settings.max_force > possible * (1.0 + 1e-9) and not self._is_homing:
            raise ValueError(
                f"the largest force or torque is {settings.max_force:g}, but current_limit_a = "
                f"{settings.current_limit_a:g} allows {possible:g}"
            )
        strokes = None if self._is_homing else settings.strokes
        self._has_limits = strokes is not None
        axes, force = len(settings.node_ids), min(settings.max_force, possible)
        lower, upper = strokes or ((-math.inf,) * axes, (math.inf,) * axes)
        self._limits = ForceLimits(lower, upper, settings.limit_lead, settings.max_velocity, force)
        within = f"{settings.heartbeat_timeout + self._timing.timeout:.2g} s"
        self.watchdog = (
            "without this computer's heartbeats the drives take their currents away within "
            f"{within}, and only mechanical brakes hold the axes"
        )

    def _at_rest(self) -> Sequence[float]:
        positions = super()._at_rest()
        for controller, velocity in zip(self._controllers, self._velocity, strict=True):
            if abs(self._settings.rpm(velocity)) > STANDSTILL:
                words = "moves without power, so its position is not remembered: what holds it?"
                raise DeviceError(self.name, f"{controller.name} {words}")
        return positions

    def _targets(self) -> list[int]:
        """Currents of the motors for the forces that are wanted of the axes, in their unit."""
        is_known = self._clock() - self._measured <= _FRESH
        allowed = self._limits.allowed(self._desired, self._position, self._velocity)
        forces = allowed if is_known else [0.0] * len(allowed)
        unit = 1e3 / self._settings.force_per_current
        axes = zip(self._controllers, forces, self._directions, strict=True)
        return [drive.current(sign * force * unit) for drive, force, sign in axes]
