"""A base that moves so that a flexible rod on it comes to rest: by feedforward, and by feedback.

The first mode of a straight rod that is moved is a mass on a spring. With its participations T in
translation and R in rotation, deflection q = T x, and the place P of the straight rod at the
distance R / T from the clamp,

    x'' + 2 d omega x' + omega^2 x = -e . P'',

along the axis e across the rod. Gravity, whose part across grows with the rod's inclination, adds
g / omega^2 to the distance. A base that moves P by u besides makes it -e . (P + u)'', and u =
(2 d x' / omega + x'' / omega^2) of the same place, its flat output, leaves the mode without an
oscillation of its own. That needs a base without lag that jumps as the acceleration does. Here u
follows the acceleration through the smoothest finite response that removes the mode's poles, lag
of the base included: what the mode does ends when that response does.

What that leaves a feedback damps, by an observer of the same modes.

Sources: Fliess, Levine, Martin and Rouchon, "Flatness and defect of non-linear systems", 1995;
the removal of poles by finite responses is that of input shaping, Singer and Seering, 1990.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues
from scipy.linalg import expm  # type: ignore[import-untyped]

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.serial_arm import SerialArm, rotated
from parapod.systems.core.elementwise import all_finite
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import elements, is_on, read, read_or_zeros
from parapod.systems.core.triples import Vector3, cross, dot, plus, scaled
from parapod.systems.core.vectors import Array, rotation_columns

type Response = Callable[[complex], complex]

# Samples by which the newest acceleration that counts is late: one until it is shown, and one for
# the rate between both of its neighbours.
_LATE = 2
# Samples by which what is observed is late when it is shown: the second differences are, by one,
# and encoders of the joints show the sample before.
_OBSERVED_LATE = 2
# Groups of the discrete state; samples, newest first, of places (6) and displacements (2).
_SHOWN, _MODES, _SAMPLES = range(3)
_SAMPLE, _COUNT = 8, 3
_ABSURD = 1e6  # sum of numbers that no measured motion has
# Share of the damping that sets in, or ceases, with each sample [-].
_SETTING_IN = 0.1


class LumpedPlace(NamedTuple):
    """Place of a mode in one plane of a straight rod.

    Attributes:
        place: the place P, in the frame of the arm's base [m].
        axis: unit vector across the rod, in the plane.
    """

    place: Vector3
    axis: Vector3


@dataclass(frozen=True)
class LumpedRod:
    """First modes of a rod, each a mass on a spring at a place of the straight rod.

    Attributes:
        straight_distance: distance R / T of the places from the clamp, but for gravity [m].
        frequencies: angular frequencies (2) of the upright rod in the planes of x and y, undamped
            [rad/s].
        damping_ratio: damping ratio of both [-].
        gravity: acceleration of free fall [m/s^2].
    """

    straight_distance: float
    frequencies: tuple[float, float]
    damping_ratio: float = 0.0
    gravity: float = GRAVITY

    @classmethod
    def of(cls, rod: FlexibleRod, gravity: float = GRAVITY) -> Self:
        """The first modes of an upright rod.

        Args:
            rod: the rod.
            gravity: acceleration of free fall [m/s^2].
        """
        x, y = rod.loaded_frequencies(gravity)[:, 0].tolist()
        straight = float(rod.rotation[0] / rod.translation[0])
        return cls(straight, (x, y), rod.damping_ratio, gravity)

    @property
    def distances(self) -> tuple[float, float]:
        """Distances (2) of the places from the clamp [m]."""
        x, y = self.frequencies
        straight, g = self.straight_distance, self.gravity
        return straight + g / x**2, straight + g / y**2

    def places(self, arm: SerialArm, position: Sequence[float]) -> tuple[LumpedPlace, LumpedPlace]:
        """Places of the modes on the last link of an arm.

        Args:
            arm: the arm, to whose last link the rod is clamped, along z.
            position: positions (n) of its joints [rad or m].
        """
        clamp, rows = arm.link_poses(position)[-1]
        x, y, z = zip(*rows, strict=True)
        along_x, along_y = (plus(clamp, scaled(z, distance)) for distance in self.distances)
        return LumpedPlace(along_x, x), LumpedPlace(along_y, y)


def at_once(z: complex) -> complex:
    """Response of a base that is always where it is asked to be."""
    return 1.0 + 0.0 * z


def cancelling_taps(
    frequency: float,
    damping_ratio: float,
    period: float,
    count: int,
    response: Response = at_once,
) -> Array:
    """Finite response from an acceleration to the motion of a base that cancels a mode.

    Of all sequences that remove the mode's poles that one is taken whose second differences, the
    jerks of the base after a jump of the acceleration, are least in the mean square.

    Args:
        frequency: angular frequency of the mode, undamped [rad/s].
        damping_ratio: its damping ratio [-].
        period: time between two samples [s].
        count: number of taps, 4 or more.
        response: factor by which the base follows samples z^k of what it is asked for.

    Returns:
        Taps (count) [s^2], by which the sampled accelerations are convolved.

    Raises:
        ValueError: fewer taps, or a mode above what the period carries.
    """
    turn = frequency * math.sqrt(1.0 - damping_ratio**2) * period
    if not (count > 3 and 0.0 < turn < 0.9 * math.pi):
        raise ValueError(
            f"a mode of {frequency / (2.0 * math.pi):.4g} Hz needs more than 3 taps and a period "
            f"below {0.9 * math.pi / frequency:.3g} s, not {count} taps and {period:g} s"
        )
    z = complex(np.exp(complex(-frequency * damping_ratio * period, turn)))
    # Second differences of the place without motion of the base, and with it, add up to zero.
    target = -1.0 / (response(z) * z**-_LATE * ((1.0 - 1.0 / z) / period) ** 2)
    powers = z ** -np.arange(count)
    conditions = np.vstack([powers.real, powers.imag])
    once = np.eye(count + 1, count) - np.eye(count + 1, count, -1)
    twice = np.eye(count + 2, count + 1) - np.eye(count + 2, count + 1, -1)
    jerk = twice @ once
    smooth = np.linalg.solve(jerk.T @ jerk, conditions.T)
    taps: Array = smooth @ np.linalg.solve(conditions @ smooth, [target.real, target.imag])
    return taps


class VibrationFeedforward(LeafSystem):
    """Displacement of a rod by its base, after which the rod's first modes are at rest.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `arm_command` | n | rad or m | positions that the arm's joints are led to |
    | out `displacement` | 4 | m, m/s | of the modes' places across, in x and y, and rates |

    Accelerations of the places are the second differences of the commands' samples. What the base
    moves besides is their convolution with `cancelling_taps`: zero while the joints rest or move
    steadily, and from `delay` after their last acceleration on.

    State: discrete, the last three commands (3n), whether there is one (1), and accelerations
    (2, m) in both planes [m/s^2], the newest first; updated every period. It begins at rest at
    the first finite command.

    Bad input: a command that is not finite in all elements is ignored, the last one stays.
    """

    def __init__(
        self,
        rod: LumpedRod,
        arm: SerialArm,
        period: float = 0.01,
        share: float = 0.5,
        response: Response = at_once,
    ):
        """Creates the system.

        Args:
            rod: the modes.
            arm: the arm that carries the rod as its last link.
            period: time between two samples [s].
            share: duration of the response by the period of the slower vibration [-].
            response: see `cancelling_taps`.

        Raises:
            ValueError: as `cancelling_taps`.
        """
        super().__init__()
        self.set_name("vibration_feedforward")
        self._rod, self._arm, self._period, self._response = rod, arm, period, response
        slowest = 2.0 * math.pi / min(rod.frequencies)
        count = max(4, round(share * slowest / period))
        self.delay = (count + 4) * period
        self._taps = [
            cancelling_taps(frequency, rod.damping_ratio, period, count, response)
            for frequency in rod.frequencies
        ]
        self._shape = 2, count + 2
        self._command = self.DeclareVectorInputPort("arm_command", arm.count)
        state = self.DeclareDiscreteState(3 * arm.count + 1 + 2 * (count + 2))
        self.DeclareVectorOutputPort(
            "displacement", 4, self._calc_displacement, {self.discrete_state_ticket(state)}
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_samples)

    def residual(self, frequency: float, plane: int = 0) -> float:
        """Vibration that is left of a mode of another frequency, by that without feedforward [-].

        Args:
            frequency: its angular frequency, undamped [rad/s].
            plane: 0 for bending in the plane of x, 1 for that of y.
        """
        damping = self._rod.damping_ratio
        turn = complex(-damping, math.sqrt(1.0 - damping**2))
        z = complex(np.exp(frequency * self._period * turn))
        moved = self._response(z) * z**-_LATE * ((1.0 - 1.0 / z) / self._period) ** 2
        return float(abs(1.0 + moved * (self._taps[plane] @ z ** -np.arange(self._shape[1] - 2))))

    def _calc_displacement(self, context: Context, output: BasicVector) -> None:
        state = context.get_discrete_state_vector().value()
        rows = state[3 * self._arm.count + 1 :].reshape(self._shape)
        # Between the newest and the oldest acceleration, so that both neighbours are known.
        moved = [taps @ row[1:-1] for taps, row in zip(self._taps, rows, strict=True)]
        rates = [
            taps @ (row[:-2] - row[2:]) / (2.0 * self._period)
            for taps, row in zip(self._taps, rows, strict=True)
        ]
        output.SetFromVector(np.array(moved + rates))

    def _update_samples(self, context: Context, discrete_state: DiscreteValues) -> None:
        state = context.get_discrete_state_vector().value()
        count = self._arm.count
        has_begun, command = state[3 * count] > 0.5, read(self._command, context)
        if not all_finite(command):
            if not has_begun:
                return
            command = state[:count].tolist()
        if has_begun:
            commands = [command, state[:count].tolist(), state[count : 2 * count].tolist()]
        else:
            commands = [command] * 3
        rows = np.roll(state[3 * count + 1 :].reshape(self._shape), 1, axis=1)
        rows[:, 0] = self._accelerations(commands)
        past = [number for each in commands for number in each]
        discrete_state.set_value(np.array([*past, 1.0, *rows.ravel()]))

    def _accelerations(self, commands: Sequence[Sequence[float]]) -> list[float]:
        """Accelerations (2) of the modes' places across, a period ago [m/s^2]."""
        now, middle, before = (self._rod.places(self._arm, command) for command in commands)
        return [
            (dot(at.axis, a.place) - 2.0 * dot(at.axis, at.place) + dot(at.axis, b.place))
            / self._period**2
            for a, at, b in zip(now, middle, before, strict=True)
        ]


class VibrationDamper(LeafSystem):
    """Displacement of a rod by its base that damps the rod's first modes.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `arm_position` | n | rad or m | positions of the arm's joints |
    | in `posture_desired_state` | 6 | rad, rad, m and rates | base without damping |
    | in `posture` | 3 | rad, rad, m | base as measured; its height over what it turns about |
    | in `fed_forward` | 4 | m, m/s | displacement by a feedforward; unconnected: 0 |
    | in `enable` | 1 | - | above 0.5: observe and damp; otherwise the modes are at rest |
    | out `displacement` | 4 | m, m/s | of the modes' places across, in x and y, and rates |

    The observer has the equation of the first modes in both planes. With y = x + u, where
    u is how far the base has moved the place off the desired posture,

        y'' + 2 d omega y' + omega^2 (y - u) = -e . P''

    with the place's acceleration by the joints and the desired posture alone. So the measured
    motion of the base is not differentiated. The base follows u = -2 `damping` y' / omega, ahead
    by its own lag, which adds `damping` to the mode's damping ratio.

    While a feedforward moves the base the damper observes only: what is planned is not to be
    damped. It ceases and sets in over a few samples.

    The rod has no sensor: only what the clamp does to it is observed, a push at its tip is not.

    State: discrete, displacement and rates (4); y and y' in both planes (4) [m, m/s]; places (6)
    and u (2) at the last three samples [m], whether they are known (1), and the share of the
    damping that has set in (1); updated every period.

    Bad input: while a measurement is not finite, or absurd, the modes are taken to be at rest.
    """

    def __init__(
        self,
        rod: LumpedRod,
        arm: SerialArm,
        period: float = 0.01,
        damping: float = 0.2,
        response: Response = at_once,
    ):
        """Creates the system.

        Args:
            rod: the modes.
            arm: the arm that carries the rod as its last link.
            period: time between two samples [s].
            damping: damping ratio that is added [-].
            response: factor by which the base follows samples z^k of what it is asked for.
        """
        super().__init__()
        self.set_name("vibration_damper")
        self._rod, self._arm, self._period = rod, arm, period
        self._steps = [_step(omega, rod.damping_ratio, period) for omega in rod.frequencies]
        self._gains = [_gains(omega, damping, period, response) for omega in rod.frequencies]
        self._position = self.DeclareVectorInputPort("arm_position", arm.count)
        self._desired = self.DeclareVectorInputPort("posture_desired_state", 6)
        self._posture = self.DeclareVectorInputPort("posture", 3)
        self._fed_forward = self.DeclareVectorInputPort("fed_forward", 4)
        self._enable = self.DeclareVectorInputPort("enable", 1)
        displacement: Any = self.DeclareDiscreteState(4)
        self.DeclareDiscreteState(4)
        self.DeclareDiscreteState(_COUNT * _SAMPLE + 2)
        self.DeclareStateOutputPort("displacement", displacement)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_modes)

    def _update_modes(self, context: Context, discrete_state: DiscreteValues) -> None:
        position, posture = read(self._position, context), read(self._posture, context)
        desired = read(self._desired, context)[:3]
        size = sum(map(abs, position + posture + desired))
        if not (is_on(self._enable, context) and size < _ABSURD):
            for group, size in ((_SHOWN, 4), (_MODES, 4), (_SAMPLES, _COUNT * _SAMPLE + 2)):
                discrete_state.set_value(group, np.zeros(size))
            return
        off = posture[0] - desired[0], posture[1] - desired[1], 0.0
        sample, axes = self._sample(position, desired, off)
        *past, is_known, share = elements(context.get_discrete_state(_SAMPLES))
        if not is_known:
            past = sample * _COUNT
            discrete_state.set_value(_MODES, np.array([sample[6], 0.0, sample[7], 0.0]))
        samples = [sample, past[:_SAMPLE], past[_SAMPLE : 2 * _SAMPLE]]
        waits = any(read_or_zeros(self._fed_forward, context))
        share = max(0.0, share - _SETTING_IN) if waits else min(1.0, share + _SETTING_IN)
        kept = past[: 2 * _SAMPLE]
        discrete_state.set_value(_SAMPLES, np.array([*sample, *kept, 1.0, share]))
        if is_known:
            modes = elements(context.get_discrete_state(_MODES))
            braking, ahead = self._observe(modes, samples, axes)
            moved = [share * way for way in braking]
            before, h = elements(context.get_discrete_state(_SHOWN)), self._period
            rates = [(now - last) / h for now, last in zip(moved, before[:2], strict=True)]
            discrete_state.set_value(_SHOWN, np.array(moved + rates))
            discrete_state.set_value(_MODES, np.array(ahead))

    def _observe(
        self, modes: Sequence[float], samples: Sequence[Sequence[float]], axes: Sequence[Vector3]
    ) -> tuple[list[float], list[float]]:
        """Displacements (2) that brake the modes, and the modes (4) a period later."""
        braking: list[float] = []
        ahead: list[float] = []
        for plane, (axis, omega) in enumerate(zip(axes, self._rod.frequencies, strict=True)):
            now, last, before = (sample[3 * plane : 3 * plane + 3] for sample in samples)
            change = [a - 2.0 * b + c for a, b, c in zip(now, last, before, strict=True)]
            # Of about the instant of the acceleration: drives of legs and joints lag as well.
            load = omega**2 * samples[1][6 + plane] - dot(axis, change) / self._period**2
            mode = modes[2 * plane : 2 * plane + 2]
            place, rate = (self._steps[plane] @ (*mode, load)).tolist()
            by_rate, by_change = self._gains[plane].tolist()
            braking.append(by_rate * rate + by_change * (rate - mode[1]) / self._period)
            ahead += place, rate
        return braking, ahead

    def _sample(
        self, position: Sequence[float], desired: Sequence[float], off: Vector3
    ) -> tuple[list[float], list[Vector3]]:
        """Places (6) on a base as desired, displacements (2) by what it is off; axes across."""
        roll, pitch, height = desired
        rows: Any = tuple(zip(*rotation_columns(roll, pitch, 0.0), strict=True))
        places: list[float] = []
        axes, moved = [], []
        for place, axis in self._rod.places(self._arm, position):
            over = plus(place, (0.0, 0.0, height))
            places += rotated(rows, over)
            axes.append(rotated(rows, axis))
            moved.append(dot(axis, cross(off, over)))
        return places + moved, axes


def _step(omega: float, damping_ratio: float, period: float) -> Array:
    """Matrix (2, 3) from a mode's place, its rate and a constant load to both a period later."""
    whole = np.zeros((3, 3))
    whole[0, 1], whole[1] = 1.0, (-(omega**2), -2.0 * damping_ratio * omega, 1.0)
    step: Array = expm(period * whole)[:2]
    return step


def _gains(omega: float, damping: float, period: float, response: Response) -> Array:
    """Factors of y' [s], and of its difference by the period [s^2]."""
    z = complex(np.exp(1j * omega * period))
    target = -2.0 * damping / (omega * response(z) * z**-_OBSERVED_LATE)
    ahead = (1.0 - 1.0 / z) / period
    parts = [[1.0, ahead.real], [0.0, ahead.imag]]
    gains: Array = np.linalg.solve(parts, [target.real, target.imag])
    return gains
