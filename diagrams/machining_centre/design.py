"""Design of a machining centre: dimensions, bodies, drives; the paper's are the defaults."""

import math
from dataclasses import dataclass, field

import numpy as np

from parapod.diagrams.bodies import Body, BodyScenario, body_of, in_si
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.machining_centre.geometry import LIMB_COUNTS, CentreGeometry
from parapod.systems.machining_centre.ranges import (
    holding_forces,
    scaled_jacobian,
    upright_heights,
)
from parapod.systems.machining_centre.statics import CentreMasses

# Smallest and largest length [mm].
_SHORT, _LONG = 1.0, 20_000.0
# Difference of lengths that is rounding, and conditioning index below which legs hold nothing [-].
_ROUNDING, _SINGULAR = 1e-9, 0.02


@dataclass
class LegScenario(Schema):
    """The legs' position-controlled drives; all values are assumptions.

    Attributes:
        max_force_N: largest force of a leg, both ways [N].
        force_per_current_N_A: force of a leg by the current of its motor [N/A].
        stiffness_N_um: axial stiffness of a leg with its screw and drive [N/um].
        max_velocity_mm_s: largest velocity of a leg [mm/s].
        time_constant_ms: time constant of the drives' velocity loop [ms].
        arrival_ms: time in which a drive makes up for what is missing of a command [ms]; null: the
            controller's period.
        encoder_resolution_mm: one count of the encoders [mm]; 0 for perfect ones.
        length_error_mm: largest error of a leg's length, drawn from the seed: what a calibration
            leaves [mm].
    """

    max_force_N: float = quantity(1000.0, 10.0, 1e6)  # noqa: N815 (the unit's symbol)
    force_per_current_N_A: float = quantity(250.0, 1.0, 1e5)  # noqa: N815
    stiffness_N_um: float = quantity(10.0, 0.1, 10_000.0)  # noqa: N815
    max_velocity_mm_s: float = quantity(150.0, 1.0, 5000.0)
    time_constant_ms: float = quantity(2.0, 0.1, 100.0)
    arrival_ms: float | None = quantity(None, 1.0, 1000.0)
    encoder_resolution_mm: float = quantity(0.001, 0.0, 0.1)
    length_error_mm: float = quantity(0.01, 0.0, 1.0)


@dataclass
class CentreDesign(Schema):
    """The centre: its dimensions are those of the paper, its masses and drives assumptions.

    Attributes:
        limbs: 3 for the tripod, 4 for the quadruped; 5 or 6.
        platform_radius_mm: radius of the circle of the platform's pivots [mm].
        half_angle_deg: angle from a limb's middle to its pivots [deg]; null: 45, or as much as
            there is room for.
        pattern_radius_mm: radius of the circle on which the feet stand at home [mm].
        stroke_min_mm: shortest leg, between pivot and foot [mm].
        stroke_max_mm: longest leg [mm].
        tool_length_mm: distance from the plane of the pivots to the drill's tip [mm].
        foot_height_mm: height of an ankle's centre above the panel [mm].
        foot_diameter_mm: diameter of a foot's plate [mm].
        platform: platform with its spindle; its frame is in the middle of the pivots.
        tool: quill and drill.
        mount: bracket of a limb at the platform.
        hinge: hinge of a limb.
        cylinder: cylinder of a leg.
        rod: rod of a leg.
        ankle: each of an ankle's two rings.
        foot: foot with its clamp's plate.
        legs: see `LegScenario`.
    """

    limbs: int = choice(3, LIMB_COUNTS)
    platform_radius_mm: float = quantity(100.0, _SHORT, _LONG)
    half_angle_deg: float | None = quantity(None, 1.0, 60.0)
    pattern_radius_mm: float = quantity(180.0, _SHORT, _LONG)
    stroke_min_mm: float = quantity(390.0, _SHORT, _LONG)
    stroke_max_mm: float = quantity(650.0, _SHORT, _LONG)
    tool_length_mm: float = quantity(480.0, _SHORT, _LONG)
    foot_height_mm: float = quantity(42.0, _SHORT, _LONG)
    foot_diameter_mm: float = quantity(100.0, _SHORT, _LONG)
    platform: BodyScenario = body_of(10.0)
    tool: BodyScenario = body_of(0.2)
    mount: BodyScenario = body_of(0.1)
    hinge: BodyScenario = body_of(0.3)
    cylinder: BodyScenario = body_of(1.4)
    rod: BodyScenario = body_of(0.7)
    ankle: BodyScenario = body_of(0.05)
    foot: BodyScenario = body_of(0.5)
    legs: LegScenario = field(default_factory=LegScenario)

    @property
    def geometry(self) -> CentreGeometry:
        """Its dimensions in SI units.

        Raises:
            ScenarioError: dimensions that no centre has; names the key.
        """
        return in_si(self, CentreGeometry)

    @property
    def masses(self) -> CentreMasses:
        """Its masses, as the plant that is built has them.

        Raises:
            ScenarioError: as `geometry`.
        """
        from parapod.diagrams.machining_centre.model import masses_of

        return masses_of(self.geometry, tuple(self.bodies.items()))

    @property
    def bodies(self) -> dict[str, Body]:
        """Its links by their names in `parapod.urdf.machining_centre`."""
        names = ("platform", "tool", "mount", "hinge", "foot")
        bodies = {name: getattr(self, name).body for name in names}
        for side in ("left", "right"):
            bodies |= {f"{side}_{name}": getattr(self, name).body for name in ("cylinder", "rod")}
        return bodies | dict.fromkeys(("ankle_2", "ankle_3"), self.ankle.body)

    def check(self) -> None:
        """Refuses a centre that cannot stand, does not reach the panel, or is too weak.

        Raises:
            ScenarioError: names the key, and the admissible values.
        """
        geometry = self.geometry
        self._check_feet(geometry)
        low, high = upright_heights(geometry)
        if not low < high:
            key = "machine.stroke_max_mm"
            aside = float(np.linalg.norm(geometry.pivots[0] - geometry.footholds[0, :3]))
            raise ScenarioError(
                f"{key} = {self.stroke_max_mm:g}: legs do not reach from the feet to the pivots, "
                f"which are {1e3 * aside:.0f} mm beside them; it must be more than that",
                key,
            )
        least, most = (1e3 * (end + geometry.foot_height) for end in (low, high))
        if not least < self.tool_length_mm < most:
            key = "machine.tool_length_mm"
            raise ScenarioError(
                f"{key} = {self.tool_length_mm:g}: the pivots of the upright platform are "
                f"{least:.0f} to {most:.0f} mm above the panel, so the drill does not touch it; "
                "it must be between them",
                key,
            )
        self._check_hold(geometry)

    def _check_feet(self, geometry: CentreGeometry) -> None:
        """Refuses feet that overlap at home."""
        apart = 2.0 * self.pattern_radius_mm * math.sin(math.pi / geometry.limbs)
        if self.foot_diameter_mm > (1.0 + _ROUNDING) * apart:
            key = "machine.foot_diameter_mm"
            raise ScenarioError(
                f"{key} = {self.foot_diameter_mm:g}: feet overlap at home, where they are "
                f"{apart:.0f} mm apart; it must be less",
                key,
            )

    def _check_hold(self, geometry: CentreGeometry) -> None:
        """Refuses legs that do not hold the platform as it drills, or are too weak for that."""
        pose = (0.0, 0.0, geometry.tool_length - geometry.foot_height, 0.0, 0.0, 0.0)
        singular = np.linalg.svd(scaled_jacobian(geometry, pose), compute_uv=False)
        if singular[-1] < _SINGULAR * singular[0]:
            key = "machine.half_angle_deg"
            angle = math.degrees(geometry.half_angle)
            raise ScenarioError(
                f"{key} = {angle:g}: the legs of the upright platform do not hold it, whatever "
                "their force: it must be larger, or the radii of pivots and feet others",
                key,
            )
        weight = self.masses.weight(geometry)
        largest = float(np.abs(holding_forces(geometry, pose, None, weight)).max())
        most = self.legs.max_force_N
        if largest > most:
            key = "machine.legs.max_force_N"
            raise ScenarioError(
                f"{key} = {most:g}: it cannot lift itself: a leg has to hold {largest:.0f} N, "
                f"{largest - most:.0f} N more; it must be at least {math.ceil(largest)}",
                key,
            )
