"""Controller of a leg: its foot is a spring towards where it is to be, and pushes in stance."""

import math
from dataclasses import dataclass, fields

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.elementwise import sumprod
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import is_on, read
from parapod.systems.terrain_simulator.leg import LegModel


@dataclass(frozen=True)
class ImpedanceParams:
    """Impedance of the foot along x and z, in stance and swing: assumptions for the default leg.

    Attributes:
        stance_stiffness: springs while the foot stands [N/m]; along x soft enough that a round
            foot rolls, and does not slip.
        stance_damping: dampers then [N s/m].
        swing_stiffness: springs while it swings [N/m].
        swing_damping: dampers then [N s/m].
        posture: spring and damper of each joint of a leg with more than two, which lead it to its
            posture without moving the foot [N m/rad, N m s/rad].
    """

    stance_stiffness: tuple[float, float] = (4e3, 8e3)
    stance_damping: tuple[float, float] = (150.0, 300.0)
    swing_stiffness: tuple[float, float] = (1.5e4, 1.5e4)
    swing_damping: tuple[float, float] = (250.0, 250.0)
    posture: tuple[float, float] = (100.0, 8.0)

    def __post_init__(self) -> None:
        for field in fields(self):
            for value in getattr(self, field.name):
                if not value >= 0.0:
                    raise ValueError(f"{field.name} must not be negative, but is {value!r}")

    def scaled(self, share: float) -> "ImpedanceParams":
        """Springs and dampers times a share, as a leg needs them that is lighter or heavier.

        Args:
            share: mass that its foot shows by that of the default leg: frequencies and damping
                ratios stay.
        """
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return ImpedanceParams(
            **{name: (share * one, share * other) for name, (one, other) in values.items()}
        )


class FootImpedance(LeafSystem):
    """Torques with which a leg stands, swings and pushes.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position` | n | rad or m | of the actuated joints |
    | in `velocity` | n | rad/s or m/s | of the actuated joints |
    | in `foot_desired` | 6 | m, s | x, z of the foot from the hip, rates, accelerations |
    | in `foot_force_desired` | 1 | N | force of the ground on the foot, upwards |
    | in `stance` | 1 | 0/1 | whether the foot stands |
    | out `torque_command` | n | N m or N | of the joints, within what the drives can give |

    Impedance control about a computed torque: with J the foot's Jacobian and L the mass that the
    foot shows to a force,

        torque = J^T (L (a_d - dJ/dt v) + K (p_d - p) + D (v_d - v) - F_d) + bias - gravity

    with other K and D in stance and in swing (Hogan 1985; as a law of quadrupeds' legs: Focchi et
    al. 2017). The hip counts as fixed. Joints beyond two are led to the posture of the model, by
    torques that do not accelerate the foot.

    State: none.

    Bad input: with a number that is not finite the torques are zero.

    Args:
        model: the leg.
        params: the impedance.
    """

    def __init__(self, model: LegModel, params: ImpedanceParams = ImpedanceParams()):
        super().__init__()
        self.set_name("foot_impedance")
        self._model, self._work = model, model.make_context()
        swing = params.swing_stiffness, params.swing_damping
        stance = params.stance_stiffness, params.stance_damping
        # Of x and z, in swing and in stance.
        self._gains = tuple(tuple(zip(*pair, strict=True)) for pair in (swing, stance))
        self._largest, self._posture, self._rest = model.max_torque, params.posture, model.posture
        self._position = self.DeclareVectorInputPort("position", model.joints)
        self._velocity = self.DeclareVectorInputPort("velocity", model.joints)
        self._foot = self.DeclareVectorInputPort("foot_desired", 6)
        self._force = self.DeclareVectorInputPort("foot_force_desired", 1)
        self._stance = self.DeclareVectorInputPort("stance", 1)
        self.DeclareVectorOutputPort(
            "torque_command", model.joints, self._calc_torque, {self.all_input_ports_ticket()}
        )

    def _calc_torque(self, context: Context, output: BasicVector) -> None:
        q, v = read(self._position, context), read(self._velocity, context)
        desired, (push,) = read(self._foot, context), read(self._force, context)
        if not all(map(math.isfinite, (*q, *v, *desired, push))):
            output.SetZero()
            return
        now = self._model.foot_state(self._work, q, v)
        gains = self._gains[is_on(self._stance, context)]
        forces = []
        for i, ((stiffness, damping), row) in enumerate(zip(gains, now.inertia, strict=True)):
            missing, slower = desired[i] - now.place[i], desired[2 + i] - now.velocity[i]
            inertial = row[0] * (desired[4] - now.bias[0]) + row[1] * (desired[5] - now.bias[1])
            forces.append(inertial + stiffness * missing + damping * slower)
        f_x, f_z = forces[0], forces[1] - push
        if self._model.joints > len(forces):
            spring, damper = self._posture
            rest = [
                spring * (at - is_at) - damper * goes
                for at, is_at, goes in zip(self._rest, q, v, strict=True)
            ]
            # What of these torques would accelerate the foot, its own force takes away.
            x_column, z_column = zip(*now.inverse, strict=True)
            f_x, f_z = f_x - sumprod(x_column, rest), f_z - sumprod(z_column, rest)
        else:
            rest = [0.0] * len(q)
        torques = [
            x * f_x + z * f_z + held_force + rest_force
            for x, z, held_force, rest_force in zip(*now.jacobian, now.holding, rest, strict=True)
        ]
        output.SetFromVector(np.array(list(map(self._within, torques, self._largest))))

    @staticmethod
    def _within(torque: float, largest: float) -> float:
        return min(max(torque, -largest), largest) if math.isfinite(torque) else 0.0
