"""Hinges in place of universal and ball joints, which not every format of models has."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, Frame, RevoluteJoint, SpatialInertia

# Axes of hinges, in their order from the parent on, by what is added to the joint's name.
PLAIN_AXES: dict[str, dict[str, tuple[float, float, float]]] = {
    "universal": {"_x": (1.0, 0.0, 0.0), "_y": (0.0, 1.0, 0.0)},
    "ball_rpy": {"_yaw": (0.0, 0.0, 1.0), "_pitch": (0.0, 1.0, 0.0), "_roll": (1.0, 0.0, 0.0)},
}
# Inertia of a link between two hinges, which no program refuses and nothing feels.
LIGHT = SpatialInertia.SolidSphereWithMass(1e-6, 1e-3)


def add_hinges(
    plant: MultibodyPlant,
    name: str,
    parent: Frame,
    child: Frame,
    axes: Mapping[str, tuple[float, float, float]],
) -> list[Any]:
    """Adds hinges one behind the other, each at the origin of its link.

    Args:
        plant: not finalized.
        name: name of the joint that they stand for.
        parent: frame on its parent.
        child: frame on its child.
        axes: axes in those frames, by what is added to the name.
    """
    link, hinges = child.body(), list[Any]()
    X_BM = child.GetFixedPoseInBodyFrame()
    before, is_beside = parent, bool(X_BM.translation().any())
    for k, (suffix, axis) in enumerate(axes.items()):
        is_last = k == len(axes) - 1
        if is_last and not is_beside:
            after = child
        else:
            body = plant.AddRigidBody(f"{name}{suffix}_link", link.model_instance(), LIGHT)
            after = body.body_frame()
        hinge = RevoluteJoint(f"{name}{suffix}", before, after, np.array(axis))
        hinges.append(plant.AddJoint(hinge))
        before = after
    if is_beside:
        end: Any = plant.AddFrame(
            FixedOffsetFrame(f"{name}_beside", link.body_frame(), RigidTransform(X_BM))
        )
        plant.WeldFrames(before, end)
    return hinges
