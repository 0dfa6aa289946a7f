"""Pictures of the levelling platform."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.levelling_platform.model import add_platform
from parapod.diagrams.photograph import View, add_renderer, take
from parapod.diagrams.wiring import add, connect
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY, ParallelLinks, standing_pose


def photograph(
    views: Sequence[View],
    posture: ArrayLike,
    ground: tuple[float, float] = (0.0, 0.0),
    arm: tuple[float, float] = (0.0, 0.0),
) -> list[NDArray[np.uint8]]:
    """Pictures (height, width, 3) of the platform in a posture on plane ground.

    Args:
        views: from where; one picture each.
        posture: (3) roll, pitch, height [rad, rad, m].
        ground: roll and pitch [rad].
        arm: turntable and arm angle [rad].

    Raises:
        UnreachablePosture: the legs do not reach it.
        RuntimeError: there is no OpenGL that Drake's renderer could use.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1.0)
    add_renderer(scene_graph)
    model = add_platform(plant, "full", ground=ground)
    state = plant.get_state_output_port()
    links = add(builder, ParallelLinks(model, scene_graph, state.size()))
    connect(builder, state, links.get_input_port())
    connect(builder, links.get_output_port(), scene_graph.get_source_pose_port(links.source_id))
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    extension = inverse_kinematics(MODEL_GEOMETRY, posture, ground)
    positions = model.positions_at(extension, standing_pose(posture, ground), arm)
    plant.SetPositions(plant.GetMyMutableContextFromRoot(context), positions)
    return take(scene_graph, context, views)
