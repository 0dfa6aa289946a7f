"""The real platform as its sensors tell it, and pale beside it what it is asked for."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, Cylinder, Meshcat, Rgba
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import PassThrough

from parapod.diagrams.levelling_platform.model import add_drawing
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.wiring import add
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.kinematics import estimate_ground, forward_kinematics
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY, standing_pose
from parapod.systems.levelling_platform.wheels import WheelGeometry

_MEASURED, _DESIRED = "measured", "desired"
_INPUTS = {"extension": LEG_COUNT, "base_pose": 7, "arm_position": 2}
_PALE = 0.25  # opacity
_SLAB, _SLAB_PATH = (2.6, 2.2, 0.04), "/measured_ground"  # [m]
_FLOOR = -0.3  # [m]


class PlatformTwin:
    """Two drawings of the platform on the ground that it has found.

    The measured one has the measured extensions and the estimated attitude; until there is an
    estimate of the ground, that on which it would stand so, on its wheels or on its feet. The
    desired one, pale, has the extensions and the posture that the legs are led to.
    """

    signals = frozenset(
        (
            "legs.extension",
            "attitude_estimated",
            "ground_estimated",
            "ground_valid",
            "foot_offsets_estimated",
            "extension_desired_state",
            "posture_desired_state",
            "arm_command",
        )
    )

    def __init__(self, meshcat: Meshcat, scenario: LevellingScenario):
        """Draws nothing yet.

        Args:
            meshcat: the scene.
            scenario: of the machine.
        """
        self._meshcat = meshcat
        builder = DiagramBuilder()
        for path in (_MEASURED, _DESIRED):
            ports = []
            for name, size in _INPUTS.items():
                through = add(builder, PassThrough(size), f"{path}_{name}")
                builder.ExportInput(through.get_input_port(), f"{path}.{name}")
                ports.append(through.get_output_port())
            extension, base_pose, arm = ports
            add_drawing(builder, (0.0, 0.0), meshcat, extension, base_pose, arm, path=path)
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        # The ground of the scenario is not that of the machine.
        meshcat.Delete("/ground")
        meshcat.SetObject(_SLAB_PATH, Box(*_SLAB), Rgba(0.50, 0.46, 0.41))
        meshcat.SetObject("/floor", Cylinder(4.5, 0.02), Rgba(0.86, 0.89, 0.91))
        meshcat.SetTransform("/floor", RigidTransform(np.array([0.0, 0.0, _FLOOR])))

    def show(self, values: Mapping[str, NDArray[Any]]) -> None:
        """See `Twin`."""
        extension, attitude = values["legs.extension"], values["attitude_estimated"]
        ground, height = _standing(values, extension, attitude)
        if not np.isfinite([*extension, *attitude, *ground]).all():
            return  # nothing is known: the last picture stays
        pose = standing_pose((*attitude, height), ground)
        arm = values.get("arm_command", np.zeros(2))
        desired = values.get("extension_desired_state", extension)[:LEG_COUNT]
        posture = values.get("posture_desired_state", np.zeros(6))[:3]
        is_posed = values["ground_valid"][0] > 0.5 and posture[2] > 0.0
        desired_pose = standing_pose(posture, ground) if is_posed else pose
        for path, numbers in (
            (_MEASURED, (extension, pose, arm)),
            (_DESIRED, (desired, desired_pose, arm)),
        ):
            for name, value in zip(_INPUTS, numbers, strict=True):
                self._diagram.GetInputPort(f"{path}.{name}").FixValue(self._context, value)
        self._diagram.ForcedPublish(self._context)
        self._dress(ground)

    def _dress(self, ground: NDArray[np.float64]) -> None:
        """Slab under the feet; of the drawings it is hidden."""
        rotation = RollPitchYaw(ground[0], ground[1], 0.0).ToRotationMatrix()
        below = np.array([0.0, 0.0, -0.5 * _SLAB[2]])
        pose = RigidTransform(rotation, rotation @ below)
        self._meshcat.SetTransform(_SLAB_PATH, pose)
        for path in (_MEASURED, _DESIRED):
            self._meshcat.SetProperty(f"{path}/ground", "visible", False)
        self._meshcat.SetProperty(_DESIRED, "modulated_opacity", _PALE)


def _standing(
    values: Mapping[str, NDArray[Any]], extension: NDArray[Any], attitude: NDArray[Any]
) -> tuple[NDArray[np.float64], float]:
    """Roll and pitch (2) of the ground [rad], and height above it [m], on feet or on wheels."""
    is_known = values["ground_valid"][0] > 0.5
    on_wheels, offsets = WheelGeometry().standing_height, np.zeros(LEG_COUNT)
    if is_known:
        ground = values["ground_estimated"]
        offsets = values.get("foot_offsets_estimated", offsets)
    else:
        ground = estimate_ground(MODEL_GEOMETRY, extension, attitude)
    on_feet = forward_kinematics(MODEL_GEOMETRY, extension, ground, foot_offsets=offsets)[2]
    if on_feet >= on_wheels:
        return ground, float(on_feet)
    return ground if is_known else attitude, on_wheels
