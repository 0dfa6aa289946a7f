"""Views of the platform: as its sensors measure it, and pale beside it what it is asked for."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, Cylinder, Meshcat, Rgba
from pydrake.math import RigidTransform, RollPitchYaw

from parapod.diagrams.levelling_platform.model import add_drawing
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.tip import draw_bending, observed_arm
from parapod.diagrams.real import MachineView
from parapod.diagrams.twin import DESIRED, MEASURED, Twin
from parapod.diagrams.wiring import add, connect
from parapod.systems.arm.flexible_arm import FlexibleArm
from parapod.systems.core.errors import WiringError
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.kinematics import estimate_ground, forward_kinematics
from parapod.systems.levelling_platform.model import standing_pose

_SLAB, _SLAB_PATH = (2.6, 2.2, 0.04), "/measured_ground"  # [m]
_FLOOR = -0.3  # [m]
_JOINTS = f"{MEASURED}.joint_state"


class PlatformTwin(Twin):
    """Two drawings of the platform on the ground that it has found.

    The measured one has the measured extensions and the estimated attitude; until there is an
    estimate of the ground, that on which it would stand so, on its wheels or on its feet. The
    desired one, pale, has the extensions and the posture that the legs are led to.

    An arm's rod that bends does so in the measured one: as it is observed, or as it sags at rest.
    """

    needed = frozenset(("legs.extension", "attitude_estimated"))
    stand_ins = {"attitude_estimated": "truth.posture"}  # noqa: RUF012
    signals = needed | {
        "ground_valid",
        "ground_estimated",
        "foot_offsets_estimated",
        "extension_desired_state",
        "posture_desired_state",
        "arm.position",
        "arm.position_command",
        "rod_observed",
    }

    def __init__(self, meshcat: Meshcat | None, scenario: LevellingScenario, prefix: str = ""):
        """Draws nothing yet; see `Twin`."""
        super().__init__(meshcat, scenario, prefix)
        self._geometry = scenario.machine.geometry
        self._on_wheels = scenario.machine.wheel_geometry.standing_height
        count = scenario.machine.masses.arm.count
        self._still = np.zeros(count)
        self._rod = observed_arm(scenario)
        for drawing in (MEASURED, DESIRED):
            extension = self.input(f"{drawing}.extension", LEG_COUNT)
            base_pose = self.input(f"{drawing}.base_pose", 7)
            arm = self.input(f"{drawing}.arm_position", count) if count else None
            path = self.path(drawing)
            model = add_drawing(
                self.builder,
                (0.0, 0.0),
                meshcat,
                extension,
                base_pose,
                arm,
                geometry=scenario.machine.geometry,
                structure=scenario.machine.structure,
                path=path,
            )
            if drawing == MEASURED and self._rod is not None:
                rod, joints = add(self.builder, self._rod), self.input(_JOINTS, 2 * count)
                connect(self.builder, base_pose, rod.GetInputPort("base_pose"))
                connect(self.builder, joints, rod.GetInputPort("joint_state"))
                draw_bending(self.builder, *model, rod)
        self.finish()
        if meshcat is None or self.is_guest:
            return
        # The ground of the scenario is not that of the machine.
        meshcat.Delete("/ground")
        size = max(1.0, scenario.machine.size)
        length, width, thickness = _SLAB
        slab = Box(size * length, size * width, thickness)
        meshcat.SetObject(_SLAB_PATH, slab, Rgba(0.50, 0.46, 0.41))
        meshcat.SetObject("/floor", Cylinder(4.5 * size, 0.02), Rgba(0.86, 0.89, 0.91))
        meshcat.SetTransform("/floor", RigidTransform(np.array([0.0, 0.0, size * _FLOOR])))

    def show(self, values: Mapping[str, NDArray[Any]], time: float = 0.0) -> None:
        """See `Twin`."""
        extension, attitude = values["legs.extension"], values["attitude_estimated"][:2]
        ground, height = self._standing(values, extension, attitude)
        if not np.isfinite([*extension, *attitude, *ground]).all():
            return  # nothing is known: the last picture stays
        pose = standing_pose((*attitude, height), ground)
        desired = values.get("extension_desired_state", extension)[:LEG_COUNT]
        posture = values.get("posture_desired_state", np.zeros(6))[:3]
        is_posed = _is_ground_known(values) and posture[2] > 0.0
        desired_pose = standing_pose(posture, ground) if is_posed else pose
        command = values.get("arm.position_command", self._still)
        positions: dict[str, NDArray[Any]] = {}
        for drawing, numbers in (
            (MEASURED, (extension, pose, values.get("arm.position", command))),
            (DESIRED, (desired, desired_pose, command)),
        ):
            names = [f"{drawing}.{name}" for name in ("extension", "base_pose", "arm_position")]
            positions |= dict(zip(names, numbers, strict=True))
        if self._rod is not None:
            arm = positions[f"{MEASURED}.arm_position"]
            positions[_JOINTS] = np.append(arm, self._still)
            self._bend(self._rod, pose, arm, values.get("rod_observed"))
        self._publish(positions, time)
        self._dress(ground, time)

    def _standing(
        self, values: Mapping[str, NDArray[Any]], extension: NDArray[Any], attitude: NDArray[Any]
    ) -> tuple[NDArray[np.float64], float]:
        """Roll and pitch (2) of the ground [rad], and height above it, on feet or wheels [m]."""
        is_known, geometry = _is_ground_known(values), self._geometry
        offsets = np.zeros(LEG_COUNT)
        if is_known:
            ground = values["ground_estimated"]
            offsets = values.get("foot_offsets_estimated", offsets)
        else:
            ground = estimate_ground(geometry, extension, attitude)
        on_feet = forward_kinematics(geometry, extension, ground, foot_offsets=offsets)[2]
        if on_feet >= self._on_wheels:
            return ground, float(on_feet)
        return ground if is_known else attitude, self._on_wheels

    def _bend(
        self,
        rod: FlexibleArm,
        pose: NDArray[np.float64],
        arm: NDArray[Any],
        modal_state: NDArray[Any] | None,
    ) -> None:
        """Bends the rod of the measured drawing: as observed, or as it sags at rest."""
        size = rod.GetOutputPort("modal_state").size()
        if modal_state is not None and modal_state.shape != (size,):
            raise WiringError(
                f"the rod of the drawing has {size} modal coordinates and rates, the signal "
                f"rod_observed {modal_state.size}"
            )
        context = rod.GetMyMutableContextFromRoot(self._context)
        rod.set_rest(context, pose, arm.tolist(), modal_state)

    def _dress(self, ground: NDArray[np.float64], time: float) -> None:
        """Slab under the feet; of the drawings it is hidden."""
        if self.meshcat is None:
            return
        for drawing in (MEASURED, DESIRED):
            self.meshcat.SetProperty(f"{self.path(drawing)}/ground", "visible", False)
        if self.is_guest:
            return
        rotation = RollPitchYaw(ground[0], ground[1], 0.0).ToRotationMatrix()
        below = np.array([0.0, 0.0, -0.5 * _SLAB[2]])
        pose = RigidTransform(rotation, rotation @ below)
        self.meshcat.SetTransform(_SLAB_PATH, pose, time)


def _is_ground_known(values: Mapping[str, NDArray[Any]]) -> bool:
    return "ground_valid" in values and values["ground_valid"][0] > 0.5


# Drawing and plots by which the machine is looked at.
VIEW = MachineView(
    PlatformTwin,
    plots=(
        "posture_desired_state[0]+attitude_estimated[0]+truth.posture[0]",
        "posture_desired_state[1]+attitude_estimated[1]+truth.posture[1]",
        "posture_desired_state[2]+truth.posture[2]",
        "legs.extension",
        "legs.voltage",
    ),
)
