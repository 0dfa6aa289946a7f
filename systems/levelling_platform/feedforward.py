"""Kinematic feedforward: from a desired posture to the extensions of all four legs.

Three legs are active; the fourth is kept on the ground by calculation, Eqs. (30)-(31).
"""

import sys
from collections.abc import Sequence
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import (  # type: ignore[attr-defined]
    BasicVector_,
    Context,
)
from pydrake.systems.scalar_conversion import TemplateSystem

from parapod.systems.core.elementwise import Elementwise
from parapod.systems.core.leaf_system import LeafSystem_
from parapod.systems.core.ports import elements, is_on, read, read_array, read_or_zeros
from parapod.systems.core.remembered import Remembered
from parapod.systems.core.templates import for_floats
from parapod.systems.core.triples import dot
from parapod.systems.levelling_platform.geometry import (
    ACTIVE_LEGS,
    LEG_COUNT,
    LegGeometry,
    PlatformGeometry,
)
from parapod.systems.levelling_platform.leg import (
    extension_on_moving_plane,
    extension_rate_on_plane,
    foot_motion,
)
from parapod.systems.levelling_platform.plane import normal_of, seen_moving


def _active_state(
    legs: Sequence[LegGeometry],
    indices: Sequence[int],
    posture: Sequence[Elementwise],
    ground: Sequence[Elementwise],
    offsets: Sequence[Elementwise],
) -> NDArray[Any]:
    """Extensions and rates (6) of the active legs for a posture and its rates (6)."""
    roll, pitch, height, roll_rate, pitch_rate, height_rate = posture
    g, g_rate = seen_moving(normal_of(*ground), roll, pitch, roll_rate, pitch_rate)
    extension, rate = [], []
    for i, leg in zip(indices, legs, strict=True):
        above = height - leg.foot_radius - offsets[i]
        d, v = extension_on_moving_plane(leg, g, g_rate, above, height_rate)
        extension.append(d)
        rate.append(v)
    return np.array(extension + rate)


def _rates(
    legs: Sequence[LegGeometry],
    extension: Sequence[Elementwise],
    posture: Sequence[Elementwise],
    ground: Sequence[Elementwise],
) -> list[Elementwise]:
    """Rates of legs that have these extensions, for a posture and its rates (6): Eq. (26)."""
    roll, pitch, _, roll_rate, pitch_rate, height_rate = posture
    g, g_rate = seen_moving(normal_of(*ground), roll, pitch, roll_rate, pitch_rate)
    return [
        extension_rate_on_plane(leg, d, g, g_rate, height_rate)
        for leg, d in zip(legs, extension, strict=True)
    ]


def _whole_state(
    geometry: PlatformGeometry,
    active_legs: Sequence[int],
    passive: int,
    active: Sequence[Elementwise],
    posture: Sequence[Elementwise],
    ground: Sequence[Elementwise],
    offsets: Sequence[Elementwise],
) -> NDArray[Any]:
    """Extensions and rates (8) of all legs, from those (6) of the active ones: Eq. (31)."""
    first = active_legs[0]
    roll, pitch, _, roll_rate, pitch_rate, _ = posture
    g, g_rate = seen_moving(normal_of(*ground), roll, pitch, roll_rate, pitch_rate)
    foot, slope = foot_motion(geometry.legs[first], active[0])
    above = dot(g, foot) + offsets[first] - offsets[passive]
    height_rate = dot(g, slope) * active[3] + dot(g_rate, foot)
    leg = geometry.legs[passive]
    extension, rate = extension_on_moving_plane(leg, g, g_rate, above, height_rate)
    desired = [extension] * LEG_COUNT + [rate] * LEG_COUNT
    for k, i in enumerate(active_legs):
        desired[i], desired[LEG_COUNT + i] = active[k], active[3 + k]
    return np.array(desired)


@TemplateSystem.define("KinematicFeedforward_", scope=sys.modules[__name__])
def KinematicFeedforward_(T: Any) -> Any:
    """Scalar-convertible form of `KinematicFeedforward` (float, AutoDiffXd)."""

    class Impl(LeafSystem_[T]):
        """Extensions of the three active legs for a desired posture (section 6.1).

        | port | size | unit | meaning |
        |---|---|---|---|
        | in `posture_desired_state` | 6 | rad, rad, m and rates | desired roll, pitch, height |
        | in `ground` | 2 | rad | roll and pitch of the ground |
        | in `foot_offsets` | 4 | m | how far each foot stands above the ground; unconnected: 0 |
        | in `extension_measured` | 4 | m | start of the integration (differential law only) |
        | in `enable` | 1 | - | above 0.5: integrate (differential law only) |
        | out `active_desired_state` | 6 | m, m/s | extensions of the active legs, their rates |

        With `law="exact"` the inverse kinematics is solved in closed form at every evaluation:
        no state, no drift. With `law="differential"` the extensions are the paper's Eq. (26)
        integrated from the measured ones, once a period; this drifts with the step's error and
        with whatever the platform is pushed by, and is kept to compare.

        State: none (exact), or discrete: extensions (3) [m] and whether started (1).

        Bad input: a posture that a leg cannot reach gives NaN for that leg, which `PiController`
        answers with zero volts; nothing is clamped silently.
        """

        def _construct(
            self,
            geometry: PlatformGeometry = PlatformGeometry(),
            law: Literal["exact", "differential"] = "exact",
            active_legs: Sequence[int] = ACTIVE_LEGS,
            period: float = 0.01,
            converter: Any = None,
        ) -> None:
            if law not in ("exact", "differential"):
                raise ValueError(f'law must be "exact" or "differential", not {law!r}')
            LeafSystem_[T].__init__(self, converter)
            self.set_name("kinematic_feedforward")
            self.geometry, self.law, self.period = geometry, law, period
            self.active_legs = tuple(active_legs)
            self._legs: tuple[LegGeometry, ...] = tuple(geometry.legs[i] for i in active_legs)
            solve = partial(_active_state, self._legs, self.active_legs)
            self._solve = Remembered(solve) if T is float else solve
            self._posture = self.DeclareVectorInputPort("posture_desired_state", 6)
            self._ground = self.DeclareVectorInputPort("ground", 2)
            self._offsets = self.DeclareVectorInputPort("foot_offsets", LEG_COUNT)
            self._measured = self.DeclareVectorInputPort("extension_measured", 4)
            self._enable = self.DeclareVectorInputPort("enable", 1)
            tickets = {self._posture.ticket(), self._ground.ticket(), self._offsets.ticket()}
            if law == "differential":
                state = self.DeclareDiscreteState(BasicVector_[T](np.zeros(4)))
                self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_integral)
                tickets |= {self.discrete_state_ticket(state), self._measured.ticket()}
            self._desired = self.DeclareVectorOutputPort(
                "active_desired_state", 6, self._calc_desired_state, tickets
            )

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(
                self,
                other.geometry,
                other.law,
                other.active_legs,
                other.period,
                converter=converter,
            )

        def _calc_desired_state(self, context: Context, output: Any) -> None:
            posture, ground = read(self._posture, context), read(self._ground, context)
            if self.law == "differential":
                extension = self._integral(context)
                rate = _rates(self._legs, extension, posture, ground)
                output.SetFromVector(np.array(extension + rate))
            else:
                offsets = read_or_zeros(self._offsets, context)
                output.SetFromVector(self._solve(posture, ground, offsets))

        def _integral(self, context: Context) -> list[Any]:
            """Integrated extensions, or the measured ones before the integration starts."""
            state = elements(context.get_discrete_state_vector())
            if state[3] > 0.5:
                return state[:3]
            measured = read_array(self._measured, context)
            return [measured[i] for i in self.active_legs]

        def _update_integral(self, context: Context, discrete_state: Any) -> None:
            extension = self._integral(context)
            if not is_on(self._enable, context):
                discrete_state.set_value(np.array([*extension, 0.0]))
                return
            rate = read_array(self._desired, context)[3:].tolist()
            ahead = [d + self.period * v for d, v in zip(extension, rate, strict=True)]
            discrete_state.set_value(np.array([*ahead, 1.0]))

    return Impl


KinematicFeedforward = for_floats(KinematicFeedforward_)


@TemplateSystem.define("PassiveLegSolver_", scope=sys.modules[__name__])
def PassiveLegSolver_(T: Any) -> Any:
    """Scalar-convertible form of `PassiveLegSolver` (float, AutoDiffXd)."""

    class Impl(LeafSystem_[T]):
        """All four extensions from those of the three active legs (section 6.3).

        | port | size | unit | meaning |
        |---|---|---|---|
        | in `active_desired_state` | 6 | m, m/s | extensions of the active legs, their rates |
        | in `posture_desired_state` | 6 | rad, rad, m and rates | for its attitude (Eq. 31) |
        | in `ground` | 2 | rad | roll and pitch of the ground |
        | in `foot_offsets` | 4 | m | how far each foot stands above the ground; unconnected: 0 |
        | out `extension_desired_state` | 8 | m, m/s | of legs 1..4, and their rates |

        State: none. The height comes from the first active leg, i_1 of Eq. (31).

        Bad input: NaN for the passive leg where it cannot reach the ground.
        """

        def _construct(
            self,
            geometry: PlatformGeometry = PlatformGeometry(),
            active_legs: Sequence[int] = ACTIVE_LEGS,
            converter: Any = None,
        ) -> None:
            LeafSystem_[T].__init__(self, converter)
            self.set_name("passive_leg_solver")
            self.geometry, self.active_legs = geometry, tuple(active_legs)
            (passive,) = set(range(LEG_COUNT)) - set(active_legs)
            solve = partial(_whole_state, geometry, self.active_legs, passive)
            self._solve = Remembered(solve) if T is float else solve
            self._active = self.DeclareVectorInputPort("active_desired_state", 6)
            self._posture = self.DeclareVectorInputPort("posture_desired_state", 6)
            self._ground = self.DeclareVectorInputPort("ground", 2)
            self._offsets = self.DeclareVectorInputPort("foot_offsets", LEG_COUNT)
            self.DeclareVectorOutputPort(
                "extension_desired_state",
                2 * LEG_COUNT,
                self._calc_desired_state,
                {
                    self._active.ticket(),
                    self._posture.ticket(),
                    self._ground.ticket(),
                    self._offsets.ticket(),
                },
            )

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(self, other.geometry, other.active_legs, converter=converter)

        def _calc_desired_state(self, context: Context, output: Any) -> None:
            desired = self._solve(
                read(self._active, context),
                read(self._posture, context),
                read(self._ground, context),
                read_or_zeros(self._offsets, context),
            )
            output.SetFromVector(desired)

    return Impl


PassiveLegSolver = for_floats(PassiveLegSolver_)
