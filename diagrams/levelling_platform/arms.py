"""Arms of a levelling platform: a rod on a turntable, one of the user's own, or none."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

from parapod.diagrams.bodies import Body, BodyScenario, body_of
from parapod.diagrams.cad_models import OwnModel
from parapod.systems.actuators.position_drive import PositionDriveParams
from parapod.systems.arm import flexible_rod
from parapod.systems.arm.serial_arm import ArmJoint, SerialArm
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, Variant, quantity

# Smallest and largest length [mm].
_SHORT, _LONG = 0.1, 20_000.0
# Angles of joints without limits, either way: a turn; of the rod's joint a quarter of one [rad].
_TURN, _QUARTER = 2.0 * math.pi, 0.5 * math.pi
# Length of the paper's rod [m], and largest effort of the drives of one of 1 kg [N m].
_LENGTH, _EFFORT = 2.02, 200.0
# Moment of inertia of the rod about its own axis [kg m^2], and masses of mount and turntable [kg].
_ALONG, _MOUNT, _TURNTABLE = 5e-4, 0.1, 0.4


@dataclass
class ArmDriveDesign(Schema):
    """Servo drive of a joint of the arm.

    Speed and acceleration are those of a swing by 45 deg in half a second; the effort is about
    that of a strain wave gear for a rod of 2 m (assumptions). Of a joint that slides, mm stand in
    the place of degrees, and N and m in that of N m and rad.

    Attributes:
        max_speed_deg_s: largest speed [deg/s].
        max_acceleration_deg_s2: largest acceleration [deg/s^2].
        max_effort_Nm: largest torque [N m]; null: 200 for the drawn arm of 1 kg and 2.02 m,
            by mass and length; that of an arm of one's own has no limit.
        lower_deg: smallest position [deg]; null: that of the model, or of the joint's kind.
        upper_deg: largest position [deg]; null: that of the model, or of the joint's kind.
        stiffness_Nm_rad: stiffness of the joint behind the drive [N m/rad]: its encoder, on the
            motor, does not measure how far it gives way.
        time_constant_ms: lag of the position behind its command [ms]; 0: none.
    """

    max_speed_deg_s: float = quantity(135.0, 0.1, 10_000.0)
    max_acceleration_deg_s2: float = quantity(1080.0, 1.0, 1e6)
    max_effort_Nm: float | None = quantity(None, 0.01, 1e6)  # noqa: N815 (the unit's symbol)
    lower_deg: float | None = quantity(None, -_LONG, _LONG)
    upper_deg: float | None = quantity(None, -_LONG, _LONG)
    stiffness_Nm_rad: float = quantity(2e4, 1.0, 1e9)  # noqa: N815
    time_constant_ms: float = quantity(0.0, 0.0, 1000.0)

    def limited(self, joint: ArmJoint, usual: float) -> ArmJoint:
        """A joint with the limits of this drive, where the joint's own leave it free, behind it.

        Args:
            joint: the joint, as its model has it.
            usual: largest position, either way, of a joint without limits [rad or m].
        """
        unit = unit_of(joint)
        low, high = (
            own if math.isfinite(own) else sign * usual
            for own, sign in ((joint.lower, -1.0), (joint.upper, 1.0))
        )
        if self.lower_deg is not None:
            low = max(joint.lower, unit * self.lower_deg)
        if self.upper_deg is not None:
            high = min(joint.upper, unit * self.upper_deg)
        compliance = 1.0 / self.stiffness_Nm_rad
        return replace(joint, lower=low, upper=high, compliance=compliance)

    def drive_of(self, joint: ArmJoint) -> PositionDriveParams:
        """Limits of the drive of a joint, in SI units."""
        unit = unit_of(joint)
        return PositionDriveParams(
            max_velocity=unit * self.max_speed_deg_s,
            max_acceleration=unit * self.max_acceleration_deg_s2,
            lower=joint.lower,
            upper=joint.upper,
            time_constant=1e-3 * self.time_constant_ms,
        )


def unit_of(joint: ArmJoint) -> float:
    """A degree of a joint that turns [rad], or a millimetre of one that slides [m]."""
    return math.radians(1.0) if joint.kind == "revolute" else 1e-3


@dataclass
class ArmDesign(Variant):
    """Root of the arms, between which a tag chooses; without one it is `!Rod`.

    Attributes:
        base_mm: place of its mount, from the platform's centre F [mm]; null: 0, 20 and 145, by the
            hips' places.
        drives: drives of its joints, as far as they are alike; see `ArmDriveDesign`.
        each_drive: drives of its joints, one for each; empty for drives that are alike.
    """

    usual_tag: ClassVar[str] = "Rod"
    moved: ClassVar = {"stiffness_Nm_rad": "drives.stiffness_Nm_rad"}

    base_mm: list[float] | None = quantity(None, -_LONG, _LONG, length=3)
    drives: ArmDriveDesign = field(default_factory=ArmDriveDesign)
    each_drive: list[ArmDriveDesign] = field(default_factory=list)

    @property
    def bodies(self) -> dict[str, Body]:
        """Links of the drawn arm by their names; none of one's own."""
        return {}

    @property
    def length(self) -> float | None:
        """Length of the drawn arm [m]; None: another arm or none."""
        return None

    @property
    def own(self) -> OwnModel | None:
        """Model of the user's own."""
        return None

    @property
    def bending(self) -> flexible_rod.FlexibleRod | None:
        """Its rod that bends, on the last link; None: it is rigid."""
        return None

    @property
    def usual_effort(self) -> float:
        """Largest effort of drives that leave it open [N m or N]."""
        return math.inf

    def efforts(self, count: int) -> tuple[float, ...]:
        """Largest efforts of the drives of the joints [N m or N].

        Args:
            count: number of the joints.
        """
        efforts = (drive.max_effort_Nm for drive in self.drive_settings(count))
        return tuple(self.usual_effort if effort is None else effort for effort in efforts)

    def drive_settings(self, count: int) -> Sequence[ArmDriveDesign]:
        """Settings of the drives of the joints.

        Args:
            count: number of the joints.

        Raises:
            ScenarioError: other than one of each joint, or none.
        """
        own, key = len(self.each_drive), "machine.arm.each_drive"
        if own not in (0, count):
            raise ScenarioError(f"{key} must have {count} elements or none, not {own}", key)
        return self.each_drive or [self.drives] * count

    def usual_reach(self, index: int, joint: ArmJoint) -> float:
        """Largest position, either way, of a joint without limits [rad or m]."""
        return _TURN if joint.kind == "revolute" else 1e-3 * _LONG

    def driven(self, arm: SerialArm) -> SerialArm:
        """The arm with limits and stiffness of its drives.

        Args:
            arm: the arm as its model has it.

        Raises:
            ScenarioError: limits that leave out zero, where it begins; or other than one drive of
                each joint.
        """
        settings = self.drive_settings(arm.count)
        joints = tuple(
            drive.limited(joint, self.usual_reach(index, joint))
            for index, (joint, drive) in enumerate(zip(arm.joints, settings, strict=True))
        )
        for joint in joints:
            if not joint.lower <= 0.0 <= joint.upper:
                key = "machine.arm.drives"
                raise ScenarioError(
                    f"{key}: {joint.name!r} goes from {joint.shown(joint.lower)} to "
                    f"{joint.shown(joint.upper)}; zero, where it begins, must be between",
                    key,
                )
        return replace(arm, joints=joints)


@dataclass
class _DrawnArm(ArmDesign):
    """Rod on a turntable.

    Attributes:
        length_mm: distance of the arm's tip from its base [mm].
    """

    length_mm: float = quantity(2020.0, _SHORT, _LONG)

    @property
    def length(self) -> float:
        """Length of the drawn arm [m]."""
        return self.length_mm / 1e3

    @property
    def usual_effort(self) -> float:
        """Largest effort by mass and length [N m]."""
        size = self.length / _LENGTH
        return _EFFORT * self.bodies["link"].mass * size * max(1.0, size)

    def usual_reach(self, index: int, joint: ArmJoint) -> float:
        """A turn of the turntable, a quarter of one of the rod, either way [rad]."""
        return _TURN if index == 0 else _QUARTER


@dataclass
class Rod(_DrawnArm):
    """The drawn arm: a rigid rod with a camera, on a turntable, upright at zero.

    Attributes:
        mount: part of the turntable that stands still.
        turntable: part that turns.
        link: the rod with what it carries; its frame is in its joint, z along it.
    """

    mount: BodyScenario = body_of(_MOUNT)
    turntable: BodyScenario = body_of(_TURNTABLE)
    link: BodyScenario = body_of(1.0)

    @property
    def bodies(self) -> dict[str, Body]:
        """Links of the drawn arm by their names."""
        return {name: getattr(self, name).body for name in ("mount", "turntable", "link")}


@dataclass
class FlexibleRod(_DrawnArm):
    """The drawn arm as a slender tube that bends, with a camera at its tip.

    Stiffness and damping are those of a tube of carbon fibre of 20 and 17.2 mm (assumption).

    Attributes:
        rod_mass_kg: mass of the tube, alike along its length [kg] (section 4).
        tip_mass_kg: mass of the camera at the tip [kg] (section 7).
        bending_stiffness_Nm2: bending stiffness in the plane in which the arm swings, and across
            it [N m^2].
        modes: number of bending modes in each plane.
        damping_ratio: damping ratio of the modes [-].
    """

    rod_mass_kg: float = quantity(0.27, 1e-3, 1e4)
    tip_mass_kg: float = quantity(0.73, 1e-3, 1e4)
    bending_stiffness_Nm2: list[float] = quantity([430.0, 430.0], 1e-3, 1e9, length=2)  # noqa: N815
    modes: int = quantity(2, 1, 3)
    damping_ratio: float = quantity(0.005, 0.0, 0.5)

    @property
    def bending(self) -> flexible_rod.FlexibleRod:
        """Its rod that bends, on the last link."""
        in_plane, across = self.bending_stiffness_Nm2
        return flexible_rod.FlexibleRod(
            length=self.length,
            mass=self.rod_mass_kg,
            tip_mass=self.tip_mass_kg,
            bending_stiffness=(in_plane, across),
            damping_ratio=self.damping_ratio,
            modes=self.modes,
        )

    @property
    def bodies(self) -> dict[str, Body]:
        """Links of the drawn arm by their names."""
        rod, tip, length = self.rod_mass_kg, self.tip_mass_kg, self.length
        mass = rod + tip
        centre = (0.5 * rod + tip) * length / mass
        across = rod * (length**2 / 12.0 + (0.5 * length - centre) ** 2)
        across += tip * (length - centre) ** 2
        link = Body(mass, (0.0, 0.0, centre), (across, across, _ALONG * mass, 0.0, 0.0, 0.0))
        return {"mount": Body(_MOUNT), "turntable": Body(_TURNTABLE), "link": link}


@dataclass
class Urdf(ArmDesign):
    """An arm of one's own: any chain of joints that turn or slide.

    Attributes:
        file: URDF or SDFormat file, or a `package://` URL.
        mount: its link or frame that is fixed to the platform in `base_mm`, z up.
        tip: its link or frame that is the tip.
        joints: its joints that are driven, from the mount to the tip; every other one must be
            fixed; empty: all that move between mount and tip.
    """

    file: str = ""
    mount: str = "base_link"
    tip: str = ""
    joints: list[str] = field(default_factory=list)

    @property
    def own(self) -> OwnModel:
        """Model of the user's own."""
        return OwnModel("machine.arm.file", self.file, self.mount, tuple(self.joints), self.tip)


@dataclass
class NoArm(ArmDesign):
    """A platform without an arm; `base_mm` is then what its tip would be."""

    tag_name: ClassVar[str] = "None"
