"""The terrain simulator's bench as bodies and joints: names, closed-form pose, loops."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context

from parapod.systems.core.batching import columns
from parapod.systems.core.elementwise import atan2, sin_cos
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import slider_places

SLIDERS = ("slider_1", "slider_2", "slider_3")
_JOINTS = (*SLIDERS, "link_1", "link_2", "plate", "strut")


@dataclass(frozen=True)
class BenchModel:
    """A finalized plant that holds a bench of `parapod.urdf.terrain_simulator`.

    The tree is rail, slider 1, link 1, plate and strut; two ball constraints close it, from the
    tip of link 2 to P and from the strut's foot to slider 3. Rotations are about the world's y.

    Attributes:
        plant: the plant.
        geometry: geometry to which the files are drawn.
    """

    plant: MultibodyPlant
    geometry: BenchGeometry

    def stand(self, context: Context, pose: ArrayLike, twist: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Puts the bench into a pose with a motion, loops closed.

        Args:
            context: the plant's context.
            pose: (3) x, z, phi of the plate's middle [m, m, rad].
            twist: (3) its rates [m/s, m/s, rad/s].
        """
        q, v = self.motion(pose, twist)
        positions, velocities = self.plant.GetPositions(context), self.plant.GetVelocities(context)
        for name, value, rate in zip(_JOINTS, q, v, strict=True):
            joint = self.plant.GetJointByName(name)
            positions[joint.position_start()], velocities[joint.velocity_start()] = value, rate
        self.plant.SetPositions(context, positions)
        self.plant.SetVelocities(context, velocities)

    def motion(
        self, pose: ArrayLike, twist: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions and velocities of the joints (7), (7) for a motion of the plate.

        Args:
            pose: (3) x, z, phi [m, m, rad].
            twist: (3) rates [m/s, m/s, rad/s].

        Returns:
            Three sliders [m, m/s], link 1, link 2, plate and strut [rad, rad/s].
        """
        q = np.array(self._positions(np.asarray(pose, dtype=float)), dtype=float)
        moving = self._positions(InitializeAutoDiff(np.asarray(pose, dtype=float)).ravel())
        v = ExtractGradient(np.array(moving)) @ np.asarray(twist, dtype=float)
        return q, v

    def pose(self, context: Context) -> NDArray[np.float64]:
        """Pose (3) x, z, phi of the plate's middle [m, m, rad].

        Args:
            context: the plant's context.
        """
        X_WP = self.plant.EvalBodyPoseInWorld(context, self.plant.GetBodyByName("plate"))
        x, z = self.geometry.p_OP
        x, _, z = X_WP @ np.array((-x, 0.0, -z))
        R = X_WP.rotation().matrix()
        return np.array((x, z, np.arctan2(R[0, 2], R[2, 2])))

    def loop_error(self, context: Context) -> NDArray[np.float64]:
        """Distances (2) by which the loops are open: link 2 and P, strut and slider 3 [m].

        Args:
            context: the plant's context.
        """

        def place(name: str, point: tuple[float, float, float]) -> NDArray[np.float64]:
            pose = self.plant.EvalBodyPoseInWorld(context, self.plant.GetBodyByName(name))
            return np.asarray(pose @ np.array(point))

        here = (0.0, 0.0, 0.0)
        ends = (
            (place("link_2", (self.geometry.link, 0.0, 0.0)), place("plate", here)),
            (place("strut", (-self.geometry.strut, 0.0, 0.0)), place("slider_3", here)),
        )
        return np.array([np.linalg.norm(one - other) for one, other in ends])

    def _positions(self, pose: NDArray[Any]) -> list[Any]:
        ((x, z, phi),), _ = columns((pose, 3, "pose"))
        a_1, a_2, a_3 = slider_places(self.geometry, pose)
        s, c = sin_cos(phi)
        (p_x, p_z), (t_x, t_z) = self.geometry.p_OP, self.geometry.p_OT
        s_1, z_P = 0.5 * (a_2 - a_1), z - s * p_x + c * p_z
        first, second = -atan2(z_P, s_1), -atan2(z_P, -s_1)
        strut = -atan2(z - s * t_x + c * t_z, x + c * t_x + s * t_z - a_3)
        return [a_1, a_2, a_3, first, second, phi - first, strut - phi]
