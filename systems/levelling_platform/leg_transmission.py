"""The reduced leg's transmission: between the actuator's rod and the parallelogram's swing."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.leg import swing_motion, swing_rate
from parapod.systems.ports import read


class LegTransmission(LeafSystem):
    """Exact, lossless transmission psi(d) of a leg whose actuator is not modelled as bodies.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `rod_state` | 8 | m, m/s | extensions and their rates to be transmitted |
    | in `extension` | 4 | m | present extensions, at which the load is taken |
    | in `swing_torque` | 4 | N m | torques that hold the swing joints |
    | out `swing_state` | 8 | rad, rad/s | angles psi and their rates |
    | out `load_force` | 4 | N | force of each rod: tau dpsi/dd, so that power is conserved |

    State: none. Bad input: NaN where an extension cannot be built.
    """

    def __init__(self, geometry: PlatformGeometry = PlatformGeometry()):
        super().__init__()
        self.set_name("leg_transmission")
        self._legs = geometry.legs
        self._rods = self.DeclareVectorInputPort("rod_state", 2 * LEG_COUNT)
        self._extension = self.DeclareVectorInputPort("extension", LEG_COUNT)
        self._torque = self.DeclareVectorInputPort("swing_torque", LEG_COUNT)
        self.DeclareVectorOutputPort(
            "swing_state", 2 * LEG_COUNT, self._calc_swing, {self._rods.ticket()}
        )
        self.DeclareVectorOutputPort(
            "load_force",
            LEG_COUNT,
            self._calc_load,
            {self._extension.ticket(), self._torque.ticket()},
        )

    def _calc_swing(self, context: Context, output: BasicVector) -> None:
        rods = read(self._rods, context)
        angles, rates = [], []
        for i, leg in enumerate(self._legs):
            angle, ratio = swing_motion(leg, rods[i])
            angles.append(angle)
            rates.append(ratio * rods[LEG_COUNT + i])
        output.SetFromVector(np.array(angles + rates))

    def _calc_load(self, context: Context, output: BasicVector) -> None:
        extension = read(self._extension, context)
        torques = read(self._torque, context)
        loads = [
            torque * swing_rate(leg, d)
            for leg, d, torque in zip(self._legs, extension, torques, strict=True)
        ]
        output.SetFromVector(np.array(loads))
