"""The rest of the robot, played by the drive of the hip's slide."""

import math
from dataclasses import dataclass

from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import declare_cached, read


@dataclass(frozen=True)
class HipSupportParams:
    """Stiffness of the other legs, which hold the body's height too: assumptions.

    Attributes:
        stiffness: force by height [N/m].
        damping: force by its rate [N s/m].
        washout: time constant with which a lasting force of these fades [s]: the other legs carry
            their own shares of the body, and none of this leg's.
        largest: largest force, both ways [N].
    """

    stiffness: float = 2e4
    damping: float = 1100.0
    washout: float = 0.2
    largest: float = 2000.0


class HipSupport(LeafSystem):
    """Force of the hip's drive: what the other legs would carry, and their stiffness.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `hip_force` | 1 | N | upwards, that the other legs are to carry |
    | in `hip_desired` | 2 | m, m/s | height of the hip, and its rate |
    | in `hip_measured` | 1 | m | its height |
    | in `hip_rate` | 1 | m/s | its rate |
    | out `force_command` | 1 | N | on the slide, upwards |

    While a leg of a walking robot is in the air, the others hold the body's height. A single leg
    on a slide would bounce off its gait's height.

    State: discrete, the lasting force (1) [N], updated every period.

    Bad input: a number that is not finite counts as none: without one of the first the force is
    zero, without a measurement only what is asked for.

    Args:
        params: stiffness and limit.
        period: between two updates [s].
    """

    def __init__(self, params: HipSupportParams = HipSupportParams(), period: float = 0.001):
        super().__init__()
        self.set_name("hip_support")
        self._params = params
        self._share = -math.expm1(-period / params.washout)
        self._force = self.DeclareVectorInputPort("hip_force", 1)
        self._desired = self.DeclareVectorInputPort("hip_desired", 2)
        self._height = self.DeclareVectorInputPort("hip_measured", 1)
        self._rate = self.DeclareVectorInputPort("hip_rate", 1)
        lasting = self.DeclareDiscreteState(1)
        measured = {port.ticket() for port in (self._desired, self._height, self._rate)}
        self._held = declare_cached(self, "held", self._calc_held, measured)
        inputs = {self._force.ticket(), self._held.ticket, self.discrete_state_ticket(lasting)}
        self.DeclareVectorOutputPort("force_command", 1, self._calc_force, inputs)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _calc_held(self, context: Context) -> float:
        """Force of the other legs' stiffness [N]."""
        height, rate = read(self._desired, context)
        (is_at,), (goes,) = read(self._height, context), read(self._rate, context)
        force = self._params.stiffness * (height - is_at) + self._params.damping * (rate - goes)
        return float(force) if math.isfinite(force) else 0.0

    def _update(self, context: Context, state: DiscreteValues) -> None:
        lasting = context.get_discrete_state(0)[0]
        state[0] = lasting + self._share * (self._held.value(self, context) - lasting)

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        (force,), largest = read(self._force, context), self._params.largest
        total = force + self._held.value(self, context) - context.get_discrete_state(0)[0]
        total = total if math.isfinite(total) else 0.0
        output[0] = min(max(total, -largest), largest)
