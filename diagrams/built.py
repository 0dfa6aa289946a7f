"""Bodies of a machine as they are built into the diagram that simulates them."""

from collections.abc import Iterator
from dataclasses import dataclass

from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, Diagram, System

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.systems.core.errors import ParapodError


@dataclass(frozen=True)
class Bodies:
    """Bodies of a machine.

    Attributes:
        plant: the plant, part of a diagram.
        scene_graph: its geometry.
        context: the plant's context at the beginning of the scenario.
        root: context of the whole diagram, to which that belongs.
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph
    context: Context
    root: Context


def bodies_of_loop(loop: ClosedLoop) -> Bodies:
    """Bodies that a closed loop simulates, at the beginning of its scenario.

    They can be seen if the loop was built while `visuals_kept`.

    Args:
        loop: the loop.

    Raises:
        ParapodError: the loop's backend simulates no bodies, or several plants of them.
    """
    parts = list(_parts(loop))
    plants = [part for part in parts if isinstance(part, MultibodyPlant)]
    if len(plants) != 1:
        count = f"{len(plants)} plants" if plants else "no plant"
        raise ParapodError(
            f"the backend {loop.scenario.backend!r} of {loop.machine.title} simulates {count} of "
            "rigid bodies, where there must be one"
        )
    (plant,), source = plants, plants[0].get_source_id()
    assert source is not None
    scenes = (part for part in parts if isinstance(part, SceneGraph))
    scene = next(one for one in scenes if one.model_inspector().SourceIsRegistered(source))
    root = loop.CreateDefaultContext()
    loop.reset(root)
    return Bodies(plant, scene, plant.GetMyContextFromRoot(root), root)


def _parts(diagram: Diagram) -> Iterator[System]:
    for part in diagram.GetSystems():
        yield part
        if isinstance(part, Diagram):
            yield from _parts(part)
