"""Positions of all joints of the chair's model, for drawing a plant that has no such joints."""

from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.ports import read_array
from parapod.systems.walking_chair.branches import BRANCHES
from parapod.systems.walking_chair.chair_model import ChairModel
from parapod.systems.walking_chair.geometry import LEG_COUNT


class ChairPose(LeafSystem):
    """Positions of the model's joints, all loops closed.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position` | 12 | m | lengths of the branches |
    | in `body_pose` | 7 | -, m | quaternion (w, x, y, z) and position of the body |
    | out `positions` | n | - | positions of the model's plant |

    State: none.

    Bad input: NaN for the joints of a leg that cannot be assembled.
    """

    def __init__(self, model: ChairModel):
        super().__init__()
        self.set_name("chair_pose")
        self._model = model
        self._position = self.DeclareVectorInputPort("position", len(BRANCHES))
        self._pose = self.DeclareVectorInputPort("body_pose", 7)
        self.DeclareVectorOutputPort(
            "positions",
            model.plant.num_positions(),
            self._calc_positions,
            {self._position.ticket(), self._pose.ticket()},
        )

    def _calc_positions(self, context: Context, output: BasicVector) -> None:
        lengths = read_array(self._position, context).reshape(LEG_COUNT, 3)
        q = self._model.positions(lengths, read_array(self._pose, context))
        output.SetFromVector(q)
