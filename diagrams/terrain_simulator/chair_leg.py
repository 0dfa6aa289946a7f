"""The walking chair's leg as the leg under test; loaded only where a scenario asks for it.

Two of the leg's three degrees of freedom place the foot, the third keeps it in the bench's plane.
The sole is at a right angle to the UP branch, so the foot rolls over its ends. Commands are forces
of the screws; the leg's own controller has a position loop about each length, as stiff as the
chair's screws (1 N/um), at 1 kHz, stable because a motor's rotor looks like 130 kg through gear
and screw (its inertia is an assumption). The foot stands on the edge of E_2 and E_3, since E_1
leaves all load to the UP branch, 521 N when two legs carry. Uphill at 10 deg a rear leg walks,
because a front leg would need 714 N.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any
from xml.etree import ElementTree

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, Frame
from pydrake.systems.framework import Context, LeafSystem

from parapod.diagrams.multibody import add_adapted_model
from parapod.diagrams.terrain_simulator.leg import AddedLeg
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.chair_leg import (
    ChairLegController,
    ChairLegModel,
    ChairScrewParams,
)
from parapod.systems.terrain_simulator.walk import BenchWalk
from parapod.systems.walking_chair.masses import ChairMasses
from parapod.systems.walking_chair.model import leg_joints
from parapod.urdf import configure_parser

_URL = "package://parapod/walking_chair/leg.urdf"
_SCREWS = ("up_length", "ups_2_length", "ups_3_length")
_TURNING = tuple(
    f"{branch}_{joint}" for branch in ("up", "ups_2", "ups_3") for joint in ("swing", "tilt")
)
# Share of rotor's mass by damping [-] that the controller's period may come to.
_LONGEST = 0.5


@dataclass(frozen=True)
class ChairLeg:
    """The walking chair's leg, whole: a UP branch, two UPS branches, a platform as its foot.

    The upper platform hangs on the slide. Screws take forces, behind which the controller has
    their position loops (`ChairLegController`), and resist with the mass of their rotors; so the
    ports of this leg mean what those of any leg mean. See `LegUnderTest`.

    Attributes:
        model: closed forms.
        screws: screws and their loops.
    """

    model: ChairLegModel = field(default_factory=ChairLegModel)
    screws: ChairScrewParams = field(default_factory=ChairScrewParams)

    @property
    def names(self) -> tuple[str, ...]:
        """See `LegUnderTest`."""
        return _SCREWS

    @cached_property
    def mass(self) -> float:
        """Mass of the leg [kg]."""
        return ChairMasses().leg

    @property
    def max_torque(self) -> tuple[float, ...]:
        """See `LegUnderTest`."""
        return (self.model.max_force,) * len(_SCREWS)

    def add(
        self, plant: MultibodyPlant, hip: Frame, scene_graph: SceneGraph | None = None
    ) -> AddedLeg:
        """See `LegUnderTest`."""
        parser = Parser(plant)
        configure_parser(parser)
        leg = add_adapted_model(parser, _URL, "leg", _without_gains)
        X_HA = RigidTransform(RotationMatrix(self.model.R_HA), self.model.p_HA)
        hung: Any = plant.AddFrame(FixedOffsetFrame("leg_mount", hip, X_HA))
        plant.WeldFrames(hung, plant.GetFrameByName("upper_platform", leg))
        for name in ("up", "ups_2", "ups_3"):
            drive = plant.GetJointActuatorByName(f"{name}_drive", leg)
            drive.set_default_gear_ratio(self.screws.ratio)
            drive.set_default_rotor_inertia(self.screws.rotor_inertia)
        foot = plant.GetFrameByName("foot", leg)
        screws, turning = (
            tuple(plant.GetJointByName(name, leg) for name in names)
            for names in (_SCREWS, _TURNING)
        )
        return AddedLeg(leg, foot, screws, self.max_torque, turning)

    def make_controller(self, period: float) -> LeafSystem:
        """See `LegUnderTest`."""
        longest = _LONGEST * self.screws.inertia / self.screws.damping
        if period > longest:
            raise ScenarioError(
                f"control.period = {period:g} s is too long for the loops of the chair's screws; "
                f"it is {longest:.2g} s at most",
                "control.period",
            )
        return ChairLegController(self.model, self.screws)

    def reach(self, foot: Array, phi: float) -> Array:
        """See `LegUnderTest`; not a number out of reach."""
        return self.model.lengths(np.asarray(foot, dtype=float), np.array(phi))

    def all_joints(self, position: Array) -> Array:
        """See `LegUnderTest`."""
        joints = leg_joints(self.model.geometry, position)
        return np.array([joints[name] for name in (*_SCREWS, *_TURNING)])

    def places(self, position: Array, phi: Array) -> Array:
        """See `LegUnderTest`."""
        return self.model.places(position, phi)

    def loop_error(self, plant: MultibodyPlant, context: Context) -> Array:
        """Distances (2) by which the leg's loops are open: rods' ends and foot [m].

        Args:
            plant: holds the leg.
            context: the plant's context.
        """
        leg = plant.GetModelInstanceByName("leg")
        names = ("ups_2_rod", "ups_3_rod", "foot")
        *rods, foot = (
            plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(name, leg)) for name in names
        )
        sockets = self.model.geometry.lower_joints[1:]
        balls = sockets @ foot.rotation().matrix().T + foot.translation()
        ends = np.array([rod.translation() for rod in rods])
        gaps: Array = np.linalg.norm(ends - balls, axis=-1)
        return gaps

    def check(self, walk: BenchWalk, period: float) -> None:
        """See `ChairLegModel.check`."""
        self.model.check(walk)


def _without_gains(root: ElementTree.Element) -> None:
    """Takes the drives' own position loops off the leg's screws: the controller has them."""
    for actuator in root.iterfind("transmission/actuator"):
        for child in list(actuator):
            if child.tag.endswith("controller_gains"):
                actuator.remove(child)
