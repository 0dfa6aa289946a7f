"""Drives that are where they are commanded to be, as far as their limits let them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.elementwise import (
    both,
    clamp,
    copysign,
    greatest,
    is_finite,
    least,
    sqrt,
)
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import elements, read
from parapod.systems.core.remembered import Remembered
from parapod.systems.core.rows import each

# Share of a limit by which a command that keeps to it may exceed it, as numbers are rounded [-].
_ROUNDED = 1e-6


@dataclass(frozen=True)
class PositionDriveParams:
    """Limits of one drive.

    Attributes:
        max_velocity: largest velocity [rad/s or m/s].
        max_acceleration: largest acceleration [rad/s^2 or m/s^2].
        lower: smallest position [rad or m].
        upper: largest position [rad or m].
        time_constant: time constant with which the position follows its command [s]; 0: at once.
    """

    max_velocity: float = math.inf
    max_acceleration: float = math.inf
    lower: float = -math.inf
    upper: float = math.inf
    time_constant: float = 0.0


class PositionDrive(LeafSystem):
    """Servo drives of an arm: at their commands while these keep to the drives' limits.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position_command` | n | rad or m | where the drives are to be |
    | out `position` | n | rad or m | where the drives are |
    | out `state` | 2n | rad or m, and per s | positions, and mean velocities of the last period |
    | out `position_measured` | n | rad or m | encoder: position at the last sample |
    | out `velocity_measured` | n | rad/s or m/s | way between the last two samples by the period |

    A drive whose command moves within its limits is exactly there. To a command that is further
    away it goes as fast as it can, and brakes in time. With a command that stops it stops at once:
    that is up to the command, and arriving it does so from three periods' acceleration at most.

    State: discrete, positions at the last sample and at the one before (2n), updated every period.

    Bad input: a command that is not finite is not followed; the drive brakes.

    Args:
        params: limits of each drive.
        period: period of the samples [s].
    """

    def __init__(self, params: Sequence[PositionDriveParams], period: float = 0.01):
        super().__init__()
        self.set_name("position_drive")
        self._count = count = len(params)
        self._period = period
        self._motion = Remembered(partial(_motion_of, tuple(params), period))
        self._command = self.DeclareVectorInputPort("position_command", count)
        self._samples: Any = self.DeclareDiscreteState(2 * count)
        state = self.discrete_state_ticket(self._samples)
        moving = {state, self._command.ticket()}
        self.DeclareVectorOutputPort("position", count, self._calc_position, moving)
        self.DeclareVectorOutputPort("state", 2 * count, self._calc_state, moving)
        self.DeclareVectorOutputPort("position_measured", count, self._calc_measured, {state})
        self.DeclareVectorOutputPort("velocity_measured", count, self._calc_velocity, {state})
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def set_position(self, context: Context, position: ArrayLike) -> None:
        """Puts the drives at rest at the given positions (n) [rad or m]."""
        context.SetDiscreteState(self._samples, np.tile(np.asarray(position, float), 2))

    def _sampled(self, context: Context) -> list[float]:
        """Positions at the last sample, and at the one before (2n)."""
        return elements(context.get_discrete_state(self._samples))

    def _motion_now(self, context: Context) -> list[float]:
        """Numbers of `state`."""
        return self._motion(self._sampled(context), read(self._command, context))

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array(self._motion_now(context)[: self._count]))

    def _calc_state(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array(self._motion_now(context)))

    def _calc_measured(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array(self._sampled(context)[: self._count]))

    def _calc_velocity(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array(_velocities(self._sampled(context), self._period)))

    def _update(self, context: Context, discrete_state: Any) -> None:
        count = self._count
        now, before = self._motion_now(context)[:count], self._sampled(context)[:count]
        discrete_state.set_value(np.array(now + before))


def _motion_of(
    params: Sequence[PositionDriveParams],
    period: float,
    samples: list[float],
    command: list[float],
) -> list[float]:
    """Positions of drives, and their mean velocities of the last period."""
    velocities = _velocities(samples, period)
    positions = samples[: len(params)]
    limits = (
        [getattr(own, field.name) for own in params] for field in fields(PositionDriveParams)
    )
    return each(partial(_led, period), positions, velocities, command, *limits) + velocities


def _velocities(samples: list[float], period: float) -> list[float]:
    """Mean velocities (n) between samples (n) and those before (n)."""
    count = len(samples) // 2
    pairs = zip(samples[:count], samples[count:], strict=True)
    return [(now - before) / period for now, before in pairs]


def _led(
    period: float,
    position: float,
    velocity: float,
    command: float,
    max_velocity: float,
    max_acceleration: float,
    lower: float,
    upper: float,
    time_constant: float,
) -> float:
    """Position of a drive, from those of the last sample."""
    change = max_acceleration * period
    if not is_finite(command):
        stopped = clamp(0.0, velocity - change, velocity + change)
        return clamp(position + period * stopped, lower, upper)
    command = clamp(command, lower, upper)
    if time_constant:
        command = position - math.expm1(-period / time_constant) * (command - position)
    missing, more = command - position, 1.0 + _ROUNDED
    slowest = greatest(least(velocity - change, 0.0), -max_velocity)
    fastest = least(greatest(velocity + change, 0.0), max_velocity)
    if both(more * slowest * period <= missing, missing <= more * fastest * period):
        return command
    speed = least(max_velocity, _stopping_speed(abs(missing), change, period))
    speed = clamp(copysign(speed, missing), velocity - change, velocity + change)
    return clamp(position + period * speed, lower, upper)


def _stopping_speed(way: float, change: float, period: float) -> float:
    """Largest speed from which a drive that slows down by `change` a period stops in a way.

    From a speed v that takes period (v^2 / 2 change + v / 2).
    """
    if math.isinf(change):
        return way / period
    half = 0.5 * change
    return sqrt(half * half + 2.0 * change * way / period) - half
