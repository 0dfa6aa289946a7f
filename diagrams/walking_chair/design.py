"""Design of a walking chair: dimensions, bodies, drives; the paper's are the defaults."""

import math
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from parapod.diagrams.bodies import Body, BodyScenario, body_of, in_si
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, quantity
from parapod.systems.walking_chair.checks import resting_forces
from parapod.systems.walking_chair.geometry import (
    ASSUMED_PLACEMENTS,
    LEG_COUNT,
    ChairGeometry,
    LegGeometry,
    LegPlacement,
)
from parapod.systems.walking_chair.masses import ChairMasses, Passenger
from parapod.systems.walking_chair.ranges import (
    overlap,
    straight_corners,
    straight_ends,
    straight_lengths,
    straight_stance,
)
from parapod.systems.walking_chair.support import support_polygon

# Smallest and largest length [mm].
_SHORT, _LONG = 0.1, 20_000.0
# Difference of lengths that is rounding [-].
_ROUNDING = 1e-9


@dataclass
class ChairLegDesign(Schema):
    """The four legs, each a 2-UPS+UP mechanism: Table 1.

    Attributes:
        a_mm: side of the upper platform's triangle [mm].
        b_mm: side of the lower platform's triangle [mm].
        t1_mm: thickness of the upper platform [mm].
        t2_mm: thickness of the lower platform [mm].
        d1_mm: upper platform's face to connector 1 [mm].
        d2_mm: connecting hole of a universal joint to its centre [mm].
        d3_mm: distance between the holes of connector 2 [mm].
        d4_mm: distance between the holes of connector 3 [mm].
        d5_mm: connector 4 to the lower platform's face [mm].
        d6_mm: length of the rotation joint of a UPS branch [mm].
        actuator_min_mm: length of an actuator, fully retracted [mm].
        actuator_max_mm: length of an actuator, fully extended [mm].
        up_extra_mm: length of the UP branch beyond its actuator's [mm].
    """

    a_mm: float = quantity(200.0, _SHORT, _LONG)
    b_mm: float = quantity(120.0, _SHORT, _LONG)
    t1_mm: float = quantity(10.0, _SHORT, _LONG)
    t2_mm: float = quantity(10.0, _SHORT, _LONG)
    d1_mm: float = quantity(21.0, _SHORT, _LONG)
    d2_mm: float = quantity(23.0, _SHORT, _LONG)
    d3_mm: float = quantity(25.0, _SHORT, _LONG)
    d4_mm: float = quantity(44.0, _SHORT, _LONG)
    d5_mm: float = quantity(20.0, _SHORT, _LONG)
    d6_mm: float = quantity(62.0, _SHORT, _LONG)
    actuator_min_mm: float = quantity(441.0, _SHORT, _LONG)
    actuator_max_mm: float = quantity(741.0, _SHORT, _LONG)
    up_extra_mm: float = quantity(150.4, _SHORT, _LONG)


@dataclass
class PlacementScenario(Schema):
    """Place of a leg on the connection plate.

    Attributes:
        x_mm: middle of its upper platform, to the right of the body's centre [mm].
        y_mm: middle of its upper platform, ahead of the body's centre [mm].
        turned: true if its UP branch is the rearmost; otherwise it is the foremost.
    """

    x_mm: float = quantity(0.0, -_LONG, _LONG)
    y_mm: float = quantity(0.0, -_LONG, _LONG)
    turned: bool = False


@dataclass
class DriveScenario(Schema):
    """The twelve velocity-controlled drives; but for the force all values are assumptions.

    Attributes:
        max_force_N: largest force of a branch, either way [N]: Eq. (53).
        rated_current_A: current of its motor at that force [A].
        stiffness_N_um: axial stiffness of a branch with its screw and drive [N/um].
        time_constant_ms: time constant of a drive's velocity loop [ms].
        max_velocity_mm_s: largest velocity of a branch [mm/s].
        gain_error: largest error of each drive's velocity as a share of it, drawn from the seed
            [-].
        offset_mm_s: largest velocity with which each drive creeps, drawn from the seed [mm/s].
        encoder_resolution_mm: one count of the encoders [mm]; 0 for perfect ones.
    """

    max_force_N: float = quantity(427.3, 1.0, 1e6)  # noqa: N815 (the unit's symbol)
    rated_current_A: float = quantity(3.0, 0.01, 1000.0)  # noqa: N815
    stiffness_N_um: float = quantity(1.0, 0.01, 10_000.0)  # noqa: N815
    time_constant_ms: float = quantity(40.0, 1.0, 500.0)
    max_velocity_mm_s: float = quantity(80.0, 1.0, 5000.0)
    gain_error: float = quantity(0.02, 0.0, 0.5)
    offset_mm_s: float = quantity(1.0, 0.0, 20.0)
    encoder_resolution_mm: float = quantity(0.005, 0.0, 1.0)

    @property
    def force_per_current(self) -> float:
        """Force of a branch by the current of its motor [N/A]."""
        return self.max_force_N / self.rated_current_A

    @property
    def stiffness(self) -> float:
        """Axial stiffness of a branch [N/m]."""
        return 1e6 * self.stiffness_N_um


def _placements() -> list[PlacementScenario]:
    return [PlacementScenario(1e3 * p.x, 1e3 * p.y, p.turned) for p in ASSUMED_PLACEMENTS]


@dataclass
class ChairDesign(Schema):
    """The chair: the legs' dimensions are those of the paper, places and masses assumptions.

    Attributes:
        leg: see `ChairLegDesign`.
        placements: places of the legs 1 to 4, from the rear left against the clock.
        seat_height_mm: height of the seat above the plane of the legs' upper faces [mm]; it
            stretches the drawn body.
        body: connection plate, seat and control box.
        upper_platform: upper platform of a leg.
        yoke: each yoke of a leg's three universal joints.
        cylinder: each cylinder of a leg's three actuators.
        rod: each rod of a leg's two UPS branches.
        foot: foot with the rod of the UP branch.
        drives: see `DriveScenario`.
    """

    leg: ChairLegDesign = field(default_factory=ChairLegDesign)
    placements: list[PlacementScenario] = field(default_factory=_placements)
    seat_height_mm: float = quantity(198.0, 1.0, 5000.0)
    body: BodyScenario = body_of(17.6)
    upper_platform: BodyScenario = body_of(0.8)
    yoke: BodyScenario = body_of(0.1)
    cylinder: BodyScenario = body_of(1.6)
    rod: BodyScenario = body_of(0.5)
    foot: BodyScenario = body_of(1.0)
    drives: DriveScenario = field(default_factory=DriveScenario)

    @property
    def geometry(self) -> ChairGeometry:
        """Its dimensions in SI units.

        Raises:
            ScenarioError: dimensions that no chair has; names the key.
        """
        key, count = "machine.placements", len(self.placements)
        if count != LEG_COUNT:
            raise ScenarioError(f"{key} must have {LEG_COUNT} elements, not {count}", key)
        placements = tuple(in_si(place, LegPlacement, key) for place in self.placements)
        leg = in_si(self.leg, LegGeometry, "machine.leg")
        return in_si(self, ChairGeometry, leg=leg, placements=placements)

    @property
    def bodies(self) -> dict[str, Body]:
        """Its links by their names in `parapod.urdf.walking_chair`."""
        bodies = {name: getattr(self, name).body for name in ("body", "upper_platform", "foot")}
        for branch in ("up", "ups_2", "ups_3"):
            for name in ("yoke", "cylinder", "rod"):
                bodies[f"{branch}_{name}"] = getattr(self, name).body
        del bodies["up_rod"]  # part of the foot
        return bodies

    @property
    def masses(self) -> ChairMasses:
        """Its masses, as the plant that is built has them.

        Raises:
            ScenarioError: as `geometry`.
        """
        from parapod.diagrams.walking_chair.model import masses_of

        return masses_of(self.geometry, tuple(self.bodies.items()))

    def check(self) -> None:
        """Refuses a chair whose legs do not close or collide, that tips over, or that is too weak.

        Raises:
            ScenarioError: names the key, and the admissible values.
        """
        self._check_loops()
        self._check_room()
        self._check_centre()
        self._check_forces()

    def _check_loops(self) -> None:
        """Refuses legs that cannot hang straight with their UP branches retracted."""
        leg = self.geometry.leg
        ups = float(straight_lengths(leg, leg.retracted_height)[1])
        low, high = leg.ups_stroke
        if low * (1.0 - _ROUNDING) <= ups <= high:
            return
        key = "machine.leg.up_extra_mm"
        most = math.floor(1e4 * (straight_ends(leg)[1] - leg.actuator_min)) / 10.0
        raise ScenarioError(
            f"{key} = {self.leg.up_extra_mm:g}: with the UP branch retracted, a leg that hangs "
            f"straight needs UPS branches of {1e3 * ups:.1f} mm, and they are {1e3 * low:.1f} to "
            f"{1e3 * high:.1f} mm long; it must be at most {most:g}",
            key,
        )

    def _check_room(self) -> None:
        """Refuses legs whose platforms run into each other."""
        leg, key = self.geometry.leg, "machine.placements"
        hinges = leg.upper_joints if leg.a >= leg.b else leg.corners
        corners = straight_corners(self.geometry, hinges)
        for (i, one), (j, other) in combinations(enumerate(corners, start=1), 2):
            if (deep := overlap(one, other)) > 0.0:
                raise ScenarioError(
                    f"{key}: the platforms of legs {i} and {j} overlap by {1e3 * deep:.0f} mm; "
                    "they must be farther apart",
                    key,
                )

    def _check_centre(self) -> None:
        """Refuses a chair whose centre of mass is not above its feet."""
        geometry, masses = self.geometry, self.masses
        legs = sum(masses.leg * np.array((place.x, place.y)) for place in geometry.placements)
        body = self.body.body.centre or (0.0, 0.0, 0.0)
        centre = (legs + masses.body * np.array(body[:2])) / masses.total
        margin = support_polygon(straight_corners(geometry)).margin(centre)
        if margin <= 0.0:
            raise ScenarioError(
                f"machine: it tips over: its centre of mass is {-1e3 * margin:.0f} mm outside its "
                "feet, legs straight; it must be between them",
                "machine",
            )

    def _check_forces(self) -> None:
        """Refuses drives that do not lift the empty chair on four feet."""
        geometry, masses, drives = self.geometry, self.masses, self.drives
        stances = straight_stance(geometry)
        empty_seat = Passenger(0.0)
        forces = resting_forces(stances, empty_seat, masses, drives.stiffness)
        largest = float(np.abs(forces).max())
        if largest > drives.max_force_N:
            key = "machine.drives.max_force_N"
            raise ScenarioError(
                f"{key} = {drives.max_force_N:g}: it cannot lift itself: a branch has to hold "
                f"{largest:.0f} N, {largest - drives.max_force_N:.0f} N more; it must be at least "
                f"{math.ceil(largest)}",
                key,
            )
