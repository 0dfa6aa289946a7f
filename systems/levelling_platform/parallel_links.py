"""The parallelograms' second long sides, drawn where the joints put them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.geometry import (
    Box,
    Cylinder,
    FrameId,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    MakePhongIllustrationProperties,
    PerceptionProperties,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import LeafSystem

from parapod.systems.levelling_platform.geometry import LegGeometry
from parapod.systems.levelling_platform.platform_model import PlatformModel
from parapod.systems.ports import read_array

_ORANGE, _DARK = np.array([0.95, 0.45, 0.10, 1.0]), np.array([0.13, 0.15, 0.19, 1.0])


def _perceived(colour: NDArray[np.float64]) -> PerceptionProperties:
    """How a renderer sees a colour."""
    properties = PerceptionProperties()
    properties.AddProperty("phong", "diffuse", Rgba(*colour))
    return properties


class ParallelLinks(LeafSystem):
    """Poses of the links parallel to the legs' lower links, for a SceneGraph.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `positions` | n | - | positions of the model's joints, or its whole state |
    | out `geometry_pose` | abstract | - | poses of the links in the world |

    These links carry nothing that the parallelogram's mimic joint does not, so the plant leaves
    them out and gains a tenth of its speed. State: none.
    """

    def __init__(self, model: PlatformModel, scene_graph: SceneGraph, size: int):
        """Registers the links' geometry.

        Args:
            model: the platform.
            scene_graph: where the links are drawn.
            size: of the input; positions come first.
        """
        super().__init__()
        self.set_name("parallel_links")
        self._model = model
        self._source = scene_graph.RegisterSource("parallel_links")
        self._frames = [
            self._register(scene_graph, i + 1, leg) for i, leg in enumerate(model.geometry.legs)
        ]
        self._positions = self.DeclareVectorInputPort("positions", size)
        self.DeclareAbstractOutputPort(
            "geometry_pose",
            Value[FramePoseVector],
            self._calc_poses,
            {self._positions.ticket()},
        )

    @property
    def source_id(self) -> Any:
        """The SceneGraph's name for this source."""
        return self._source

    def _register(self, scene_graph: SceneGraph, number: int, leg: LegGeometry) -> FrameId:
        """A frame at the link's hip end, x along the link, with two bars and a pin."""
        frame = GeometryFrame(f"parallel_link_{number}")
        frame_id = scene_graph.RegisterFrame(self._source, frame)
        bar = Box(leg.l_4, 0.008, 0.034)
        across = RotationMatrix.MakeXRotation(0.5 * np.pi)
        for name, shape, colour, X_LG in (
            ("left", bar, _ORANGE, RigidTransform(np.array([leg.l_4 / 2.0, 0.028, 0.0]))),
            ("right", bar, _ORANGE, RigidTransform(np.array([leg.l_4 / 2.0, -0.028, 0.0]))),
            (
                "pin",
                Cylinder(0.016, 0.066),
                _DARK,
                RigidTransform(across, np.array([leg.l_4, 0.0, 0.0])),
            ),
        ):
            instance = GeometryInstance(X_LG, shape, name)
            instance.set_illustration_properties(MakePhongIllustrationProperties(colour))
            instance.set_perception_properties(_perceived(colour))
            scene_graph.RegisterGeometry(self._source, frame_id, instance)
        return frame_id

    def _calc_poses(self, context: Any, output: Any) -> None:
        positions = read_array(self._positions, context)
        poses = FramePoseVector()
        X_WF = self._model.base_pose(positions)
        legs = zip(self._model.geometry.legs, self._frames, strict=True)
        for i, (leg, frame) in enumerate(legs):
            R_FD = RotationMatrix.MakeZRotation(leg.beta)
            p_EL_D = np.array([leg.l_3 * leg.e_a[0], 0.0, leg.l_3 * leg.e_a[1]])
            p_FL = R_FD.matrix() @ p_EL_D - np.array([leg.l_x, leg.l_y, leg.l_z])
            # The joints turn about -y, so that a positive angle turns x towards z.
            R_DL = RotationMatrix.MakeYRotation(-self._model.swing(i, positions))
            poses.set_value(frame, X_WF.multiply(RigidTransform(R_FD.multiply(R_DL), p_FL)))
        output.set_value(poses)
