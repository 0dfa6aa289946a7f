"""Homing of the platform's legs against their switches, and its check on the ground."""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.homing import (
    BySwitch,
    Check,
    Homing,
    HomingError,
    Procedure,
    Sign,
    Stopwatch,
    Tell,
    Values,
    lead,
)
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.kinematics import (
    forward_kinematics,
    inverse_kinematics,
    unevenness,
)
from parapod.systems.levelling_platform.plane import attitude_seeing

_EXTENSION, _LIMITS, _ACCEL = "legs.extension", "legs.limits", "imu.accel"
_EXTENDED, _CONTACT = slice(0, LEG_COUNT), slice(2 * LEG_COUNT, 3 * LEG_COUNT)
# Voltages of the search, by a supply [V]; share of the first with which legs look for the ground.
_FAST, _SLOW, _SUPPLY, _LOWERING = 1.0, 0.3, 12.0, 0.5
# Longest search, depth below first contact at which the ground is given up, and height at which a
# touching foot is no longer believed, by the way between the end stops [-].
_STROKE, _DEEPEST, _HIGHEST = 1.0625, 0.15, 0.5
# Ratio of the longest time of a leg on its way down to that by its voltage [-].
_SLOWEST = 2.0
# Way by which the legs then retract, which lifts the platform by six times that [m].
_RISE = 2e-3
# Legs come up together: a leg that is ahead of another waits within the first of these, more than
# the second is a fault; they go on for the third once no foot touches [m].
_WAITS, _APART, _CLEAR = 5e-4, 2e-3, 2e-3
# Share of the way by its voltage that a leg has come up by, after a while [-, s].
_SHARE, _GRACE = 0.2, 1.0
# Time in which the inertial sensor is averaged, machine at rest [s].
_AVERAGED = 1.0
# While legs look for their ends it may tilt by so much [deg], smoothed over a time [s].
_STEADY, _SMOOTHED = 1.5, 0.3
# On a floor that is flat to 12 mm, six times an extension's error [m, m, deg].
_TOUCH_BOUND, _PLANE_BOUND, _TILT_BOUND = 2e-3, 3e-3, 0.4


def _sign(driver: Any, index: int, period: float) -> Sign:
    return BySwitch(_LIMITS, index)


def _positions(usual: float, driver: Any) -> list[float]:
    """Extensions at which the switches close [m]: the driver's, or the machine's usual one."""
    own = getattr(driver, "extended_mm", None)
    return [usual if own is None else 1e-3 * own] * LEG_COUNT


def raise_feet(
    highest: float, homing: Homing, driver: Any, period: float, tell: Tell
) -> Procedure[None]:
    """Raises all legs together, until the platform is on its wheels and no foot touches.

    A platform whose program was killed stands on legs of unknown lengths;
    one that went up alone would tilt it. Encoders without a reference tell ways all the same: a
    leg that is ahead waits for the others. One that is at its end already, as a search that was
    broken off leaves it, stays there.

    Args:
        highest: way after which no foot can touch [m].
        homing: the search.
        driver: the legs' driver.
        period: period of the loop [s].
        tell: told what happens.

    Raises:
        HomingError: a leg does not come up, or a foot touches however far it does.
    """
    values = yield [0.0] * LEG_COUNT
    if not _touching(values).any():
        return
    tell("feet touch the ground: all legs come up together")
    start_values, elapsed, free = np.array(values[_EXTENSION]), 0.0, np.inf
    watch = Stopwatch(_EXTENSION)
    watch.lap(values)
    while True:
        going = np.array(values[_LIMITS])[_EXTENDED] < 0.5
        if not going.any():
            return
        way = np.array(values[_EXTENSION]) - start_values
        last = int(np.argmin(np.where(going, way, np.inf)))
        first = int(np.argmax(np.where(going, way, -np.inf)))
        if not way[first] - way[last] <= _APART:
            raise HomingError(
                f"leg {last + 1} does not come up with leg {first + 1}: "
                f"{1e3 * way[last]:.1f} mm and {1e3 * way[first]:.1f} mm by now; encoder or drive"
            )
        least = _SHARE * homing.gain * homing.slow * elapsed if elapsed > _GRACE else -_APART
        if not way[last] >= least:
            raise HomingError(f"leg {last + 1} does not come up: encoder, drive or supply")
        if not _touching(values).any():
            free = min(free, way[last])
        if way[last] > highest and not np.isfinite(free):
            i = int(np.argmax(_touching(values)))
            raise HomingError(
                f"foot {i + 1} touches although its leg has come up by {1e3 * way[i]:.0f} mm: "
                "is its contact switch stuck?"
            )
        if way[last] > free + _CLEAR:
            return
        ahead = (way - way[last]) / _WAITS
        values = yield (going * homing.slow * np.clip(1.0 - ahead, 0.0, 1.0)).tolist()
        elapsed += watch.lap(values)


class Tilting:
    """Ends a search in which the platform tilts: it stands on a leg that moves.

    A contact switch that does not close would have had it take a platform on its feet for one on
    its wheels.
    """

    def __init__(self, period: float):
        """Knows nothing yet.

        Args:
            period: period of the loop [s].
        """
        self._watch, self._left = Stopwatch(_ACCEL), _AVERAGED - period
        self._force = np.zeros(3)
        self._begun: NDArray[np.float64] | None = None

    def __call__(self, values: Values) -> None:
        """Looks at the inertial sensor.

        Raises:
            HomingError: the platform has tilted.
        """
        force = np.array(values[_ACCEL])
        if not self._force.any():
            self._force = force
        lap_time = self._watch.lap(values)
        self._force = self._force + lap_time / _SMOOTHED * (force - self._force)
        self._left -= lap_time
        if self._left > 1e-9:
            return
        down = self._force / np.linalg.norm(self._force)
        if self._begun is None:
            self._begun = down
        tilt = float(np.degrees(np.arccos(np.clip(down @ self._begun, -1.0, 1.0))))
        if not tilt <= _STEADY:
            raise HomingError(
                f"the platform has tilted by {tilt:.1f} deg while a leg looked for its end: does "
                "it stand on that leg, with a contact switch that does not close?"
            )


def _touching(values: Values) -> NDArray[np.bool_]:
    """Contact switches (4) that are closed."""
    return np.array(values[_LIMITS])[_CONTACT] > 0.5


def check_on_floor(
    machine: PlatformDesign, homing: Homing, driver: Any, period: float
) -> Procedure[list[Check]]:
    """Lowers the legs onto the floor on which the wheels stand, and rises a little on them.

    Wheels and feet then stand on one plane, so each leg's extension at first contact is known
    from the drawing; so is that the feet are in a plane, and, however the floor is inclined and
    whatever the inertial sensor's bias, by how much the platform tilts when it is lifted.

    Args:
        machine: the platform.
        homing: the search.
        driver: the legs' driver.
        period: period of the loop [s].

    Raises:
        HomingError: a foot finds no ground.
    """
    geometry, expected = machine.geometry, on_floor(machine)
    low, high = machine.stops
    rolling = yield from _inclination(period)
    touched = yield from _lower(homing, float(expected.min()) - _DEEPEST * (high - low))
    lifting = (touched - _RISE).tolist()
    standing = yield from lead(homing, _EXTENSION, lifting)
    stood = np.array(standing[_EXTENSION])
    lifted = yield from _inclination(period)
    yield from lead(homing, _EXTENSION, [machine.raised] * LEG_COUNT)
    posture = forward_kinematics(geometry, stood, np.zeros(2))
    tilt = np.degrees(lifted - rolling - posture[:2])
    plane = unevenness(geometry, touched)
    return [
        Check(
            "touch_error_mm",
            1e3 * float(np.abs(touched - expected).max()),
            "mm",
            1e3 * _TOUCH_BOUND,
            "extension at first contact against the drawing, wheels and feet on one floor",
        ),
        Check(
            "plane_error_mm",
            1e3 * float(np.abs(plane).max()),
            "mm",
            1e3 * _PLANE_BOUND,
            "distance of the feet from one plane at first contact",
        ),
        Check(
            "inclination_error_deg",
            float(np.abs(tilt).max()),
            "deg",
            _TILT_BOUND,
            "tilt when the legs lift the platform, by the sensor against the extensions",
        ),
    ]


def on_floor(machine: PlatformDesign) -> NDArray[np.float64]:
    """Extensions (4) with which the feet touch the floor on which the wheels stand [m].

    Args:
        machine: the platform.
    """
    posture = (0.0, 0.0, machine.wheel_geometry.standing_height)
    return inverse_kinematics(machine.geometry.with_stroke(machine.stops), posture, np.zeros(2))


def _lower(homing: Homing, deepest: float) -> Procedure[NDArray[np.float64]]:
    """Lowers all legs until each foot touches; extensions at first contact (4) [m]."""
    values, lowering = (yield [0.0] * LEG_COUNT), _LOWERING * homing.fast
    touched, elapsed, watch = np.full(LEG_COUNT, np.nan), 0.0, Stopwatch(_EXTENSION)
    watch.lap(values)
    longest = _SLOWEST * (max(values[_EXTENSION]) - deepest) / (homing.gain * lowering)
    while np.isnan(touched).any():
        here = np.array(values[_EXTENSION])
        new = np.isnan(touched) & _touching(values)
        touched = np.where(new, here, touched)
        if (here[np.isnan(touched)] < deepest).any():
            i = int(np.argmin(np.where(np.isnan(touched), here, np.inf)))
            raise HomingError(
                f"foot {i + 1} has found no ground at {1e3 * here[i]:.1f} mm, where the wheels' "
                "floor should be: reference, contact switch or floor"
            )
        if elapsed > longest:
            i = int(np.argmax(np.isnan(touched)))
            raise HomingError(f"leg {i + 1} does not come down: encoder, drive or supply")
        values = yield np.where(np.isnan(touched), -lowering, 0.0).tolist()
        elapsed += watch.lap(values)
    return touched


def _inclination(period: float) -> Procedure[NDArray[np.float64]]:
    """Roll and pitch (2) of the platform at rest, by the accelerometer [rad]."""
    force = np.zeros(3)
    count = round(_AVERAGED / period)
    values: Values
    for k in range(2 * count):
        values = yield [0.0] * LEG_COUNT
        if k >= count:  # at rest by now
            force += np.array(values[_ACCEL])
    x, y, z = (force / np.linalg.norm(force)).tolist()
    return np.array(attitude_seeing((x, y, z), (0.0, 0.0, 1.0)))


def make_homing(machine: PlatformDesign) -> Homing:
    """The homing of a platform's legs.

    Args:
        machine: the platform.
    """
    low, high = machine.stops
    way, supply = high - low, machine.actuators.supply_voltage / _SUPPLY
    return Homing(
        command="voltage",
        measures="extension",
        gain=machine.actuators.params.gain,
        fast=_FAST * supply,
        slow=_SLOW * supply,
        longest=_STROKE * way,
        sign=_sign,
        positions=partial(_positions, machine.actuators.switches.extended),
        size=LEG_COUNT,
        others=(_LIMITS, _EXTENDED),
        begin=partial(raise_feet, _HIGHEST * way),
        watch=Tilting,
        checks=partial(check_on_floor, machine),
        parts=("imu",),
        rest={"stop": 0.0},
        prepare="on a flat floor, on its wheels or on its feet, nothing below it",
        checking="all legs come down to the floor, and lift the platform a little",
    )
