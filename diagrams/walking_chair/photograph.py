"""Pictures of the walking chair."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.photograph import View, add_renderer, take
from parapod.diagrams.walking_chair.model import add_chair
from parapod.systems.walking_chair.chair import chair_inverse
from parapod.systems.walking_chair.gait import Walk
from parapod.systems.walking_chair.masses import Passenger
from parapod.systems.walking_chair.model import CHAIR_GEOMETRY


def photograph(
    views: Sequence[View], walk: Walk, time: float, passenger: Passenger
) -> list[NDArray[np.uint8]]:
    """Pictures (height, width, 3) of the chair at a time of a walk.

    Args:
        views: from where; one picture each.
        walk: the gaits.
        time: since the walk began [s].
        passenger: who sits on it; one without mass is not seen.

    Raises:
        RuntimeError: there is no OpenGL that Drake's renderer could use.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1.0)
    add_renderer(scene_graph)
    model = add_chair(plant, passenger)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    motion = walk.motion(CHAIR_GEOMETRY, time)
    body = motion.body.position
    lengths = chair_inverse(
        CHAIR_GEOMETRY, body, np.eye(3), motion.feet.position, motion.references
    )
    model.stand(plant.GetMyMutableContextFromRoot(context), lengths, body, passenger)
    return take(scene_graph, context, views)
