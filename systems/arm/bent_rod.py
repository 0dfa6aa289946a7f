"""Drawing of a rod as it bends: the shapes of its straight link, along its curve."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.common.value import Value
from pydrake.geometry import (
    Cylinder,
    FrameId,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    Role,
    SceneGraph,
    Shape,
)
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_array

# Pieces into which a long cylinder is cut, and length of one that is cut, by that of the rod [-].
_PIECES, _LONG = 16, 0.5
# Length by which pieces overlap, so that no gaps are seen where the rod bends [m].
_OVERLAP = 2e-3
_ALONG = 1.0 - 1e-9  # cosine of an axis that is along the rod
_NOWHERE = 1e6  # numbers from here on are of no pose


@dataclass(frozen=True)
class _Piece:
    """A shape, its pose on the straight rod, and the cross-section that carries it."""

    pose: RigidTransform
    frame: FrameId
    station: float  # [m]


class BentRod(LeafSystem):
    """Poses of the shapes of a rod that bends, for a SceneGraph.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `clamp_pose` | 7 | -, m | quaternion (w, x, y, z) and place of the rod's clamp |
    | in `modal_state` | 4m | - | coordinates of its modes, and their rates |
    | out `geometry_pose` | abstract | - | poses of the shapes in the world |

    The shapes are those that are drawn with the rigid link, from which they are taken. A cylinder
    along the rod is cut into pieces; every other shape keeps its place on its cross-section.

    State: none.

    Bad input: of numbers that are not finite all shapes are drawn at the origin.
    """

    def __init__(
        self, rod: FlexibleRod, plant: MultibodyPlant, link: RigidBody, scene_graph: SceneGraph
    ):
        """Takes the shapes of the link.

        Args:
            rod: the rod.
            plant: plant that has the link, registered with `scene_graph`.
            link: rigid link whose z axis is along the rod, its origin in the clamp.
            scene_graph: scene graph in which the link is drawn.
        """
        super().__init__()
        self.set_name("bent_rod")
        self._rod = rod
        self._source = scene_graph.RegisterSource("bent_rod")
        self._pieces = list(self._take(plant, link, scene_graph))
        stations = np.array([piece.station for piece in self._pieces])
        self._shapes, self._slopes = rod.shape(stations), rod.slope(stations)
        self._clamp = self.DeclareVectorInputPort("clamp_pose", 7)
        self._modal = self.DeclareVectorInputPort("modal_state", 4 * rod.modes)
        self.DeclareAbstractOutputPort(
            "geometry_pose",
            Value[FramePoseVector],
            self._calc_poses,
            {self._clamp.ticket(), self._modal.ticket()},
        )

    @property
    def source_id(self) -> Any:
        """The SceneGraph's name for this source."""
        return self._source

    def _take(
        self, plant: MultibodyPlant, link: RigidBody, scene_graph: SceneGraph
    ) -> Iterator[_Piece]:
        """Takes what is drawn with the link, and registers it anew, each piece on its own."""
        frame = plant.GetBodyFrameIdOrThrow(link.index())
        source, inspector = plant.get_source_id(), scene_graph.model_inspector()
        assert source is not None
        for geometry in inspector.GetGeometries(frame, Role.kIllustration):
            shape = inspector.GetShape(geometry)
            # Copied: the geometry is removed below.
            X_LG = RigidTransform(inspector.GetPoseInFrame(geometry).GetAsMatrix4())
            properties = {
                "set_illustration_properties": inspector.GetIllustrationProperties(geometry),
                "set_perception_properties": inspector.GetPerceptionProperties(geometry),
            }
            name = inspector.GetName(geometry).rpartition("::")[2]
            for i, (part, X_LP) in enumerate(_parts(shape, X_LG, self._rod.length)):
                carrier = GeometryFrame(f"{name}_{i}")
                frame_id = scene_graph.RegisterFrame(self._source, carrier)
                instance = GeometryInstance(RigidTransform(), part, f"{name}_{i}")
                for setter, own in properties.items():
                    if own is not None:
                        getattr(instance, setter)(own)
                scene_graph.RegisterGeometry(self._source, frame_id, instance)
                station = min(max(float(X_LP.translation()[2]), 0.0), self._rod.length)
                yield _Piece(X_LP, frame_id, station)
            scene_graph.RemoveGeometry(source, geometry)

    def _calc_poses(self, context: Any, output: Any) -> None:
        clamp, modal = read_array(self._clamp, context), read_array(self._modal, context)
        poses, m = FramePoseVector(), self._rod.modes
        numbers = np.concatenate((clamp, modal))
        is_somewhere = clamp[:4].any() and (np.abs(numbers) < _NOWHERE).all()
        X_WL = RigidTransform()
        if is_somewhere:
            rotation = RotationMatrix(Quaternion(clamp[:4] / np.linalg.norm(clamp[:4])))
            X_WL = RigidTransform(rotation, clamp[4:])
        x, y = self._shapes @ modal[:m], self._shapes @ modal[m : 2 * m]
        by_x, by_y = self._slopes @ modal[:m], self._slopes @ modal[m : 2 * m]
        for i, piece in enumerate(self._pieces):
            if not is_somewhere:
                poses.set_value(piece.frame, RigidTransform())
                continue
            turn = RollPitchYaw(-by_y[i], by_x[i], 0.0).ToRotationMatrix()
            X_LS = RigidTransform(turn, np.array([x[i], y[i], piece.station]))
            X_SP = RigidTransform(np.array([0.0, 0.0, -piece.station])).multiply(piece.pose)
            poses.set_value(piece.frame, X_WL.multiply(X_LS).multiply(X_SP))
        output.set_value(poses)


def _parts(
    shape: Shape, X_LG: RigidTransform, length: float
) -> Iterator[tuple[Shape, RigidTransform]]:
    """A shape and its pose, or the pieces of one that is long and along the rod."""
    along = abs(float(X_LG.rotation().matrix()[2, 2])) > _ALONG
    if not (isinstance(shape, Cylinder) and along and shape.length() > _LONG * length):
        yield shape, X_LG
        return
    size = shape.length() / _PIECES
    piece = Cylinder(shape.radius(), size + _OVERLAP)
    for i in range(_PIECES):
        middle = np.array([0.0, 0.0, (i + 0.5) * size - 0.5 * shape.length()])
        yield piece, X_LG.multiply(RigidTransform(middle))
