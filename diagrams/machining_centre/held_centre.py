"""A machining centre of rigid bodies by itself: its legs hold commanded lengths."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from parapod.diagrams.drawing import remove_visuals
from parapod.diagrams.machining_centre.model import add_centre
from parapod.diagrams.multibody import add_plant
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.model import CentreModel, pose_of
from parapod.systems.machining_centre.platform_mode import leg_lengths


@dataclass(frozen=True)
class HeldCentre:
    """A centre whose legs hold lengths.

    Attributes:
        diagram: the whole.
        model: the bodies.
    """

    diagram: Diagram
    model: CentreModel

    def stand(
        self, root_context: Context, pose: ArrayLike, footholds: ArrayLike | None = None
    ) -> None:
        """Puts the centre at rest, all feet clamped, and has the legs hold their lengths."""
        self.model.stand(self.context(root_context), pose, footholds)
        self.hold(root_context, leg_lengths(self.model.geometry, pose, footholds))

    def hold(self, root_context: Context, lengths: ArrayLike) -> None:
        """Has the legs hold lengths (2n) [m] from now on."""
        context, plant = self.context(root_context), self.model.plant
        for limb, pair in zip(self.model.limbs, np.reshape(lengths, (-1, 2)), strict=True):
            state = np.concatenate((pair, np.zeros(2)))
            plant.get_desired_state_input_port(limb).FixValue(context, state)

    def pose(self, root_context: Context) -> NDArray[np.float64]:
        """Pose (6) of the platform [m, rad]."""
        plant = self.model.plant
        return pose_of(plant.EvalBodyPoseInWorld(self.context(root_context), self.model.platform))

    def context(self, root_context: Context) -> Context:
        """The plant's context."""
        return self.model.plant.GetMyMutableContextFromRoot(root_context)


def make_held_centre(
    geometry: CentreGeometry, time_step: float, accuracy: float | None = None
) -> HeldCentre:
    """Builds a centre.

    Args:
        geometry: the centre.
        time_step: time step of the plant, the longest with an accuracy [s].
        accuracy: accuracy of the plant, see `add_plant` [m, rad]; None for steps of one length.
    """
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, time_step, "lagged", accuracy)
    model = add_centre(plant, geometry)
    remove_visuals(plant, scene_graph)
    diagram = builder.Build()
    diagram.set_name("centre_bench")
    return HeldCentre(diagram, model)
