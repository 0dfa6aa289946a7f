"""The leg under test: a protocol, and legs from a URDF, whatever they are called there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any, Protocol

import numpy as np
from pydrake.geometry import AddContactMaterial, ProximityProperties, Role, SceneGraph, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import Frame, Joint, ModelInstanceIndex
from pydrake.systems.framework import LeafSystem

from parapod.diagrams.cad_models import find_frame, find_joints, parse_model
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.impedance import FootImpedance, ImpedanceParams
from parapod.systems.terrain_simulator.leg import LegModel
from parapod.systems.terrain_simulator.walk import BenchWalk

DEFAULT_URDF = "package://parapod/terrain_simulator/leg.urdf"
# A joint without a limit is taken as one that turns or slides so far [rad or m].
_FREE = 100.0
# Places of the foot in a stride at which the leg's reach is looked at.
_LOOKED_AT = 120


@dataclass(frozen=True)
class LegDescription:
    """Place of a leg's description, and what the bench must know of it besides.

    Attributes:
        urdf: URDF or SDFormat file, or a `package://` URL.
        hip_frame: link or frame that is fixed to the slide, x to the front and z up.
        foot_frame: link or frame in the middle of the round foot.
        joints: actuated joints, in the order of the ports of the leg.
        posture: (n) positions in which it stands, about [rad or m].
        foot_radius: radius of the round foot [m].
        max_torque: (n) largest torques of the joints' drives; None: those of the file [N m or N].
        friction: coefficient of friction of the foot on the plate [-].
    """

    urdf: str = DEFAULT_URDF
    hip_frame: str = "hip"
    foot_frame: str = "foot"
    joints: tuple[str, ...] = ("hip", "knee")
    posture: tuple[float, ...] = (math.radians(35.0), math.radians(-70.0))
    foot_radius: float = 0.02
    max_torque: tuple[float, ...] | None = None
    friction: float = 0.8


@dataclass(frozen=True)
class AddedLeg:
    """A leg in a plant that is not finalized.

    Attributes:
        instance: its model instance.
        foot: frame in the middle of its foot.
        joints: its actuated joints, in the order of its ports.
        max_torque: (n) largest torques [N m or N].
        passive: its other joints.
    """

    instance: ModelInstanceIndex
    foot: Frame
    joints: tuple[Joint, ...]
    max_torque: tuple[float, ...]
    passive: tuple[Joint, ...] = ()


class LegUnderTest(Protocol):
    """Leg that the bench can take: its part in a plant, its controller, its closed forms.

    All places are those of the ground under the foot's middle as `BenchWalk` has them, from the
    hip; the ports of a leg have n numbers.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the actuated joints (n), in the order of the ports."""

    @property
    def mass(self) -> float:
        """Mass of the leg [kg]."""

    @property
    def max_torque(self) -> tuple[float, ...]:
        """Largest torques (n) of the drives [N m or N]."""

    def add(
        self, plant: MultibodyPlant, hip: Frame, scene_graph: SceneGraph | None = None
    ) -> AddedLeg:
        """Adds the leg to a plant that is not finalized, its hip fixed to a frame.

        Args:
            plant: the plant.
            hip: the frame, x to the front and z up.
            scene_graph: scene graph with which the plant is registered; None: nothing collides.
        """

    def make_controller(self, period: float) -> LeafSystem:
        """The leg's own controller.

        Its output is `torque_command` (n); inputs are among `position` (n), `velocity` (n) and the
        signals of the walk.

        Args:
            period: sampling period [s].

        Raises:
            ScenarioError: a period that is too long.
        """

    def reach(self, foot: Array, phi: float) -> Array:
        """Positions (n) of the actuated joints [rad or m] with the foot at x, z (2) [m].

        Args:
            foot: the place.
            phi: angle of the plate there [rad].
        """

    def all_joints(self, position: Array) -> Array:
        """Positions of all joints, the passive ones after those that are actuated (n)."""

    def places(self, position: Array, phi: Array) -> Array:
        """x, z (k, 2) of the foot [m] at positions (k, n), over a plate at angles (k) [rad]."""

    def check(self, walk: BenchWalk, period: float) -> None:
        """Refuses a walk that the leg cannot do.

        Args:
            walk: the walk.
            period: period of the drives' commands [s]; 0: nothing moves it.

        Raises:
            ParapodError: why.
        """


def add_leg(
    plant: MultibodyPlant,
    leg: LegDescription,
    hip: Frame,
    scene_graph: SceneGraph | None = None,
) -> AddedLeg:
    """Adds a leg to a plant, its hip fixed to a frame; only its foot collides.

    Args:
        plant: not finalized.
        leg: its description.
        hip: the frame.
        scene_graph: scene graph with which the plant is registered; None: nothing collides.

    Raises:
        ScenarioError: the file cannot be read, or has no link or joint of a name; names those that
            it has.
    """
    instance = parse_model(plant, leg.urdf, "leg.urdf")
    plant.RenameModelInstance(instance, "leg")
    own_hip, foot = (
        find_frame(plant, instance, getattr(leg, name), f"leg.{name}", leg.urdf)
        for name in ("hip_frame", "foot_frame")
    )
    joints = find_joints(plant, instance, leg.joints, "leg.joints", leg.urdf)
    if len(leg.posture) != len(leg.joints):
        raise ScenarioError(
            f"leg.posture must have {len(leg.joints)} numbers, as leg.joints, "
            f"not {len(leg.posture)}",
            "leg.posture",
        )
    plant.WeldFrames(hip, own_hip)
    largest = _add_drives(plant, instance, leg, joints)
    if scene_graph is not None:
        _round_foot(plant, scene_graph, instance, leg, foot)
    return AddedLeg(instance, foot, joints, largest)


def make_leg_model(leg: LegDescription) -> LegModel:
    """The leg alone, its hip fixed to the world.

    Raises:
        ScenarioError: see `add_leg`; or the leg cannot stand.
    """
    plant = MultibodyPlant(time_step=0.0)
    added = add_leg(plant, leg, plant.world_frame())
    plant.Finalize()
    context = plant.CreateDefaultContext()
    return LegModel(
        plant,
        added.foot,
        tuple(joint.position_start() for joint in added.joints),
        leg.posture,
        leg.joints,
        added.max_torque,
        plant.CalcTotalMass(context, [added.instance]),
    )


@dataclass(frozen=True)
class UrdfLeg:
    """Leg with a round foot that a URDF describes; see `LegUnderTest`.

    Attributes:
        description: file of the leg, and its settings.
        gains: fields of `ImpedanceParams` that are given, and their values; the others are those
            of the default leg, in the proportion of the masses that the feet show.
    """

    description: LegDescription = field(default_factory=LegDescription)
    gains: tuple[tuple[str, tuple[float, float]], ...] = ()

    @cached_property
    def model(self) -> LegModel:
        """The leg alone."""
        return make_leg_model(self.description)

    @property
    def impedance(self) -> ImpedanceParams:
        """Impedance of its foot."""
        share = self.model.least_mass / _usual_mass()
        gains: dict[str, Any] = dict(self.gains)
        return replace(ImpedanceParams().scaled(share), **gains)

    @property
    def names(self) -> tuple[str, ...]:
        """See `LegUnderTest`."""
        return self.model.names

    @property
    def mass(self) -> float:
        """See `LegUnderTest`."""
        return self.model.mass

    @property
    def max_torque(self) -> tuple[float, ...]:
        """See `LegUnderTest`."""
        return self.model.max_torque

    def add(
        self, plant: MultibodyPlant, hip: Frame, scene_graph: SceneGraph | None = None
    ) -> AddedLeg:
        """See `LegUnderTest`."""
        return add_leg(plant, self.description, hip, scene_graph)

    def make_controller(self, period: float) -> LeafSystem:
        """See `LegUnderTest`."""
        return FootImpedance(self.model, self.impedance)

    def reach(self, foot: Array, phi: float) -> Array:
        """See `LegUnderTest`."""
        return self.model.reach(foot)

    def all_joints(self, position: Array) -> Array:
        """See `LegUnderTest`."""
        return position

    def places(self, position: Array, phi: Array) -> Array:
        """See `LegUnderTest`."""
        context = self.model.make_context()
        return np.array([self.model.place(context, q) for q in position])

    def check(self, walk: BenchWalk, period: float) -> None:
        """Refuses a walk out of the leg's reach, and dampers with which its foot would rattle.

        Raises:
            UnreachableFoot: tells where, and what is missing.
            ScenarioError: names the damper, and the largest that a sampled foot bears.
        """
        if period > 0.0:
            self._check_damping(period)
        stride = np.linspace(*walk.steady, _LOOKED_AT)
        times = np.concatenate(([0.0], stride, [walk.duration]))
        self.model.follow(walk.at(times).foot[0])

    def _check_damping(self, period: float) -> None:
        impedance, mass = self.impedance, self.model.least_mass
        most = mass / period
        for name in ("stance_damping", "swing_damping"):
            damping = max(getattr(impedance, name))
            if damping > most:
                key = f"leg.{name}_Ns_m"
                raise ScenarioError(
                    f"{key} = {damping:.4g} N s/m is too much for a foot of {mass:.2g} kg; "
                    f"with control.period = {period:g} s it is at most {most:.4g} N s/m",
                    key,
                )


@cache
def _usual_mass() -> float:
    """Least mass that the foot of the default leg shows [kg]."""
    return make_leg_model(LegDescription()).least_mass


def _add_drives(
    plant: MultibodyPlant,
    instance: ModelInstanceIndex,
    leg: LegDescription,
    joints: Sequence[Joint],
) -> tuple[float, ...]:
    """Actuators of the joints that have none in the file; the largest torques of all."""
    actuators = {
        int(actuator.joint().index()): actuator
        for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
    }
    if leg.max_torque is not None and len(leg.max_torque) != len(joints):
        raise ScenarioError(
            f"leg.max_torque must have {len(joints)} numbers, as leg.joints, "
            f"not {len(leg.max_torque)}",
            "leg.max_torque",
        )
    drives = []
    for i, joint in enumerate(joints):
        actuator = actuators.get(int(joint.index()))
        if actuator is None:
            actuator = plant.AddJointActuator(joint.name(), joint)
        limit = actuator.effort_limit() if leg.max_torque is None else leg.max_torque[i]
        drives.append(float(limit))
    return tuple(drives)


def _round_foot(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    instance: ModelInstanceIndex,
    leg: LegDescription,
    foot: Frame,
) -> None:
    """Has the foot alone collide, as a ball."""
    source = plant.get_source_id()
    assert source is not None
    for index in plant.GetBodyIndices(instance):
        for geometry in plant.GetCollisionGeometriesForBody(plant.get_body(index)):
            scene_graph.RemoveRole(source, geometry, Role.kProximity)
    properties = foot_contact(leg.friction)
    place = foot.GetFixedPoseInBodyFrame() @ RigidTransform(np.zeros(3))
    plant.RegisterCollisionGeometry(
        foot.body(), place, Sphere(leg.foot_radius), "foot", properties
    )


def foot_contact(friction: float = 0.8) -> ProximityProperties:
    """Stiffness, damping and friction of a foot, and of ground as the plate is."""
    properties = ProximityProperties()
    AddContactMaterial(
        dissipation=10.0,
        point_stiffness=1e6,
        friction=CoulombFriction(friction, friction),
        properties=properties,
    )
    return properties
