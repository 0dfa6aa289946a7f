"""Builds the levelling platform's bodies, joints and ground into a MultibodyPlant."""

import logging
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, PdControllerGains, RevoluteJoint

from parapod.systems.levelling_platform.platform_model import WHEEL_COUNT, PlatformModel
from parapod.urdf import configure_parser

_FOLDER = "package://parapod/levelling_platform"
# Of the wheels' position servos [N m/rad, N m s/rad] (assumption).
_WHEEL_GAINS = PdControllerGains(p=2000.0, d=50.0)


def _concerns_us(record: logging.LogRecord) -> bool:
    """False for Drake's warning that a half space does not touch deformable bodies: none here."""
    return "half spaces are not currently supported for deformable" not in record.getMessage()


logging.getLogger("drake").addFilter(_concerns_us)


def add_platform(
    plant: MultibodyPlant,
    leg_model: str = "full",
    wheels: str = "braked",
    ground: tuple[float, float] = (0.0, 0.0),
) -> PlatformModel:
    """Adds platform and ground to a plant that is part of a diagram, and finalizes it.

    Args:
        plant: a plant with a registered scene graph and a time step above zero.
        leg_model: "full" or "reduced".
        wheels: "braked" makes them part of the base, "rolling" gives them driven joints.
        ground: roll and pitch of the ground [rad] until `PlatformModel.stand` inclines it.
    """
    parser = Parser(plant)
    configure_parser(parser)
    parser.AddModels(url=f"{_FOLDER}/platform_{leg_model}.dmd.yaml")
    for i in range(1, WHEEL_COUNT + 1):
        axle = plant.GetFrameByName(f"axle_{i}")
        wheel = plant.GetFrameByName("wheel", plant.GetModelInstanceByName(f"wheel_{i}"))
        if wheels == "braked":
            plant.WeldFrames(axle, wheel)
        else:
            turn = plant.AddJoint(RevoluteJoint(f"wheel_{i}", axle, wheel, np.array([0, 1.0, 0])))
            plant.AddJointActuator(f"wheel_{i}", turn).set_controller_gains(_WHEEL_GAINS)
    (slab,) = parser.AddModels(url=f"{_FOLDER}/ground.sdf")
    X_WG = RigidTransform(RollPitchYaw(ground[0], ground[1], 0.0), np.zeros(3))
    mount: Any = plant.AddFrame(FixedOffsetFrame("ground_mount", plant.world_frame(), X_WG))
    plant.WeldFrames(mount, plant.GetFrameByName("ground", slab))
    plant.Finalize()
    return PlatformModel(plant, mount)
