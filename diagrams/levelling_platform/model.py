"""Builds the levelling platform's bodies, joints and ground into a MultibodyPlant."""

from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame

from parapod.systems.levelling_platform.platform_model import PlatformModel
from parapod.urdf import configure_parser

_FOLDER = "package://parapod/levelling_platform"


def add_platform(plant: MultibodyPlant, leg_model: str = "full") -> PlatformModel:
    """Adds platform and ground to a plant that is part of a diagram, and finalizes it.

    Args:
        plant: a plant with a registered scene graph and a time step above zero.
        leg_model: "full" or "reduced".
    """
    parser = Parser(plant)
    configure_parser(parser)
    parser.AddModels(url=f"{_FOLDER}/platform_{leg_model}.dmd.yaml")
    (ground,) = parser.AddModels(url=f"{_FOLDER}/ground.sdf")
    mount = plant.AddFrame(
        FixedOffsetFrame("ground_mount", plant.world_frame(), RigidTransform.Identity())
    )
    plant.WeldFrames(mount, plant.GetFrameByName("ground", ground))
    plant.Finalize()
    return PlatformModel(plant, mount)
