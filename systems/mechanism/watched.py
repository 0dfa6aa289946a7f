"""Measures of a simulated mechanism: the pose of its frame, and the gaps in its loops."""

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_array, read_object
from parapod.systems.mechanism.equations import pose_vector
from parapod.systems.mechanism.mechanism import Mechanism

type Floats = NDArray[np.float64]


class FramePose(LeafSystem):
    """Pose of a frame of a plant, by the poses of its bodies.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `body_poses` | abstract | - | poses of the plant's bodies |
    | out `pose` | 6 | m, rad | x, y, z, roll, pitch, yaw of the frame in the world |

    State: none.

    Bad input: none; a plant's poses are always some.

    Args:
        frame: frame of a plant that is finalized.
        name: name of the system.
    """

    def __init__(self, frame: Frame, name: str = "frame_pose"):
        super().__init__()
        self.set_name(name)
        self._body = int(frame.body().index())
        self._place = frame.GetFixedPoseInBodyFrame()
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]([]))
        self.DeclareVectorOutputPort("pose", 6, self._calc_pose, {self._poses.ticket()})

    def _calc_pose(self, context: Context, output: BasicVector) -> None:
        poses = read_object(self._poses, context)
        output.SetFromVector(pose_vector(poses[self._body] @ self._place))


class LoopGaps(LeafSystem):
    """Largest gaps in the loops of a mechanism.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `positions` | q | m, rad | positions of all joints of the mechanism's plant |
    | out `loop_error` | 2 | m, rad | largest distance and largest angle that a loop misses by |

    State: none.

    Bad input: NaN where a position is not finite.

    Args:
        mechanism: the mechanism.
    """

    def __init__(self, mechanism: Mechanism):
        super().__init__()
        self.set_name("loop_gaps")
        self._mechanism = mechanism
        self._positions = self.DeclareVectorInputPort("positions", mechanism.plant.num_positions())
        self.DeclareVectorOutputPort("loop_error", 2, self._calc_error, {self._positions.ticket()})

    def _calc_error(self, context: Context, output: BasicVector) -> None:
        q = read_array(self._positions, context)
        output.SetFromVector(self._error(q) if np.isfinite(q).all() else np.full(2, np.nan))

    def _error(self, q: Floats) -> Floats:
        gaps = [(gap.length, gap.angle) for gap in self._mechanism.gaps(q)]
        return np.array([(0.0, 0.0), *gaps]).max(axis=0)
