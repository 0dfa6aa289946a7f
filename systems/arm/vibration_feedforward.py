"""Feedforward of a base that moves so that a flexible rod on it comes to rest.

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

Sources: Fliess, Levine, Martin and Rouchon, "Flatness and defect of non-linear systems", 1995;
the removal of poles by finite responses is that of input shaping, Singer and Seering, 1990.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.serial_arm import SerialArm
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import read
from parapod.systems.core.triples import Vector3, dot, plus, scaled
from parapod.systems.core.vectors import Array

type Response = Callable[[complex], complex]

# Samples by which the newest acceleration that counts is late: one until it is shown, and one for
# the rate between both of its neighbours.
_LATE = 2


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
        if not np.isfinite(command).all():
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
