"""Outer inclination loop: the measured attitude corrects the desired one.

`ForwardKinematics` closes it where it is linearised: posture from extensions, as a system.
"""

import math
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import (  # type: ignore[attr-defined]
    BasicVector_,
    Context,
)
from pydrake.systems.scalar_conversion import TemplateSystem

from parapod.systems.core.elementwise import clamp
from parapod.systems.core.leaf_system import LeafSystem_
from parapod.systems.core.ports import elements, has_value, is_on, read, read_or_zeros
from parapod.systems.core.templates import for_floats
from parapod.systems.core.triples import dot
from parapod.systems.levelling_platform.geometry import ACTIVE_LEGS, LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.plane import attitude_seeing, normal_of, normal_over


@dataclass(frozen=True)
class PostureLoopParams:
    """Design of the loop: integral action around a plant that has gain 1 already.

    Attributes:
        gain: k of the correction's rate k * error [1/s]; the loop's crossover in rad/s.
        lag: age of the measured attitude when it is compared, actuators' lag and sensor's delay
            together [s]; the reference is compared as it was that long ago, so that a steady
            motion is not taken for an error.
        limit: largest correction of roll and pitch, either way [rad]; several times what
            manufacturing tolerances make of the inclination.
    """

    gain: float = 1.0
    lag: float = 0.03
    limit: float = math.radians(1.0)


@TemplateSystem.define("PostureLoop_", scope=sys.modules[__name__])
def PostureLoop_(T: Any) -> Any:
    """Scalar-convertible form of `PostureLoop` (float, AutoDiffXd)."""

    class Impl(LeafSystem_[T]):
        """Integral correction of roll and pitch by the estimated attitude.

        The paper closes no loop around the kinematic feedforward and names it as the next step
        (section 8): errors of the kinematic model stay in the inclination. This loop removes
        them as far as the inertial sensor is right, and holds its correction while that cannot be
        trusted; the height stays with the feedforward.

        | port | size | unit | meaning |
        |---|---|---|---|
        | in `posture_desired_state` | 6 | rad, rad, m and rates | what is asked for |
        | in `attitude` | 2 | rad | estimated roll and pitch |
        | in `trusted` | 1 | - | above 0.5: the attitude may be followed; unconnected: always |
        | in `enable` | 1 | - | above 0.5: correct; otherwise the correction is zero |
        | out `posture_corrected_state` | 6 | rad, rad, m and rates | what the legs are asked for |

        State: discrete, corrections of roll and pitch (2) [rad], updated every period. They begin
        at zero and move with a limited rate: nothing jumps.

        Parameters (Context): gain, lag, limit (3).

        Bad input: an axis whose desired or estimated angle is not finite keeps its correction; a
        desired state that is not finite is passed on.
        """

        def _construct(
            self,
            params: PostureLoopParams = PostureLoopParams(),
            period: float = 0.01,
            converter: Any = None,
        ) -> None:
            LeafSystem_[T].__init__(self, converter)
            self.set_name("posture_loop")
            self.params, self.period = params, period
            self._desired = self.DeclareVectorInputPort("posture_desired_state", 6)
            self._attitude = self.DeclareVectorInputPort("attitude", 2)
            self._trusted = self.DeclareVectorInputPort("trusted", 1)
            self._enable = self.DeclareVectorInputPort("enable", 1)
            self._design = self.DeclareNumericParameter(
                BasicVector_[T]([params.gain, params.lag, params.limit])
            )
            state = self.DeclareDiscreteState(BasicVector_[T](np.zeros(2)))
            self.DeclareVectorOutputPort(
                "posture_corrected_state",
                6,
                self._calc_corrected_state,
                {self._desired.ticket(), self.discrete_state_ticket(state)},
            )
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_correction)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(self, other.params, other.period, converter=converter)

        def _calc_corrected_state(self, context: Context, output: Any) -> None:
            posture = read(self._desired, context)
            correction = elements(context.get_discrete_state_vector())
            posture[0] = posture[0] + correction[0]
            posture[1] = posture[1] + correction[1]
            output.SetFromVector(np.array(posture))

        def _update_correction(self, context: Context, discrete_state: Any) -> None:
            if not is_on(self._enable, context):
                discrete_state.set_value(np.zeros(2))
                return
            if has_value(self._trusted, context) and not is_on(self._trusted, context):
                return
            correction = elements(context.get_discrete_state_vector())
            gain, lag, limit = elements(context.get_numeric_parameter(self._design))
            desired, attitude = read(self._desired, context), read(self._attitude, context)
            for i in range(2):
                error = desired[i] - lag * desired[3 + i] - attitude[i]
                if math.isfinite(error if type(error) is float else error.value()):
                    candidate = correction[i] + gain * self.period * error
                    correction[i] = clamp(candidate, -limit, limit)
            discrete_state.set_value(np.array(correction))

    return Impl


PostureLoop = for_floats(PostureLoop_)


@TemplateSystem.define("ForwardKinematics_", scope=sys.modules[__name__])
def ForwardKinematics_(T: Any) -> Any:
    """Scalar-convertible form of `ForwardKinematics` (float, AutoDiffXd)."""

    class Impl(LeafSystem_[T]):
        """Posture of a platform that stands on its active legs, Eqs. (10)-(12) in closed form.

        | port | size | unit | meaning |
        |---|---|---|---|
        | in `extension` | 4 | m | extensions of the legs |
        | in `ground` | 2 | rad | roll and pitch of the ground |
        | in `foot_offsets` | 4 | m | how far each foot stands above the ground; unconnected: 0 |
        | out `posture` | 3 | rad, rad, m | roll, pitch, height |

        State: none.

        Bad input: NaN where an extension cannot be built.
        """

        def _construct(
            self, geometry: PlatformGeometry = PlatformGeometry(), converter: Any = None
        ) -> None:
            LeafSystem_[T].__init__(self, converter)
            self.set_name("forward_kinematics")
            self.geometry = geometry
            self._extension = self.DeclareVectorInputPort("extension", LEG_COUNT)
            self._ground = self.DeclareVectorInputPort("ground", 2)
            self._offsets = self.DeclareVectorInputPort("foot_offsets", LEG_COUNT)
            self.DeclareVectorOutputPort(
                "posture",
                3,
                self._calc_posture,
                {self._extension.ticket(), self._ground.ticket(), self._offsets.ticket()},
            )

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(self, other.geometry, converter=converter)

        def _calc_posture(self, context: Context, output: Any) -> None:
            extension = read(self._extension, context)
            offsets = read_or_zeros(self._offsets, context)
            feet = [foot_to_centre(self.geometry.legs[i], extension[i]) for i in ACTIVE_LEGS]
            g = normal_over(feet, [offsets[i] for i in ACTIVE_LEGS])
            height = dot(g, feet[0]) + offsets[0] + self.geometry.foot_radius
            n = normal_of(*read(self._ground, context))
            output.SetFromVector(np.array([*attitude_seeing(g, n), height]))

    return Impl


ForwardKinematics = for_floats(ForwardKinematics_)
