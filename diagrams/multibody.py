"""Multibody plants as all machines simulate them."""

from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.systems.framework import DiagramBuilder


def add_discrete_plant(
    builder: DiagramBuilder, time_step: float, contact_approximation: str
) -> tuple[MultibodyPlant, SceneGraph]:
    """Adds a plant with point contact and its scene graph.

    Its output ports are not sampled: that would make every step an unrestricted update, which
    copies the whole state of the diagram. Whoever feeds one of them back samples that one.

    Args:
        builder: of the diagram.
        time_step: of the plant [s].
        contact_approximation: Drake's discrete contact approximation.
    """
    plant, scene_graph = AddMultibodyPlant(
        MultibodyPlantConfig(
            time_step=time_step,
            contact_model="point",
            discrete_contact_approximation=contact_approximation,
            use_sampled_output_ports=False,
        ),
        builder,
    )
    return plant, scene_graph
