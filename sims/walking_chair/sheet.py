"""Data sheet of the walking chair: what follows from its dimensions, masses and drives."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull  # type: ignore[import-untyped]

from parapod.diagrams.style import COLOURS
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.sims.output.figures import Figure
from parapod.sims.sheet.sheet import (
    Demonstration,
    Dimension,
    Sheet,
    Table,
    Wrench,
    conditioning,
    entry,
    extents,
    polar_axes,
)
from parapod.systems.core.physics import GRAVITY
from parapod.systems.walking_chair.checks import Stances, resting_forces, walked_stances
from parapod.systems.walking_chair.gait import TrotGait, Walk, starting_lengths
from parapod.systems.walking_chair.geometry import LEG_COUNT, ChairGeometry
from parapod.systems.walking_chair.masses import ChairMasses, Passenger, centre_of_mass
from parapod.systems.walking_chair.ranges import (
    FootPlaces,
    body_stiffness,
    foot_jacobian,
    foot_places,
    gait_speed,
    largest_size,
    level_range,
    standing_heights,
    straight_corners,
    straight_lengths,
)
from parapod.systems.walking_chair.support import GaitSupport

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Directions in which the ground rises that are looked at.
_DIRECTIONS = 72
# Cells along each coordinate of a foot's workspace, and largest lean of its UP branch [rad]: its
# joints allow 90 deg, but a foot that leans more than this does not stand.
_CELLS, _LEAN = 24, math.radians(45.0)
# Heaviest passenger that is looked for, by what all branches push together [-], and halvings.
_HEAVIEST, _HALVINGS = 1.0, 24
# Share of a limit that is tried with rigid bodies.
_TRIED = 0.95


class ChairSheet(Sheet[ChairScenario, ChairGeometry, ChairMasses]):
    """Data sheet of a chair, with the passenger on it and in the gait of its scenario.

    The wrench acts at the middle of the seat, the body lifted to walk.
    """

    usual_wrench: ClassVar[Wrench] = (50.0, 0.0, -560.0, 0.0, 0.0, 0.0)
    highlights = (
        "mass_kg", "passenger_kg", "walking_speed_mm_s", "longest_step_mm", "branch_reserve",
        "support_margin_mm",
    )  # fmt: skip

    # Parts of the machine that entries share.

    @cached_property
    def _passenger(self) -> Passenger:
        return self.scenario.passenger.passenger

    @cached_property
    def _gait(self) -> TrotGait:
        return replace(self.scenario.walk.gaits[0], cycles=1)

    @cached_property
    def _walk(self) -> Walk:
        return Walk((self._gait,))

    @cached_property
    def _heights(self) -> tuple[float, float]:
        """Smallest and largest height of S above level ground, legs straight [m]."""
        return standing_heights(self.geometry.leg)

    @cached_property
    def _lifted(self) -> float:
        """Height of S above the ground while it walks [m]."""
        return self.geometry.leg.retracted_height + self._gait.lift

    @cached_property
    def _feet(self) -> NDArray[np.float64]:
        """Corners (4, 3, 2) of the feet from S, from above [m]."""
        return straight_corners(self.geometry)

    @cached_property
    def _middles(self) -> NDArray[np.float64]:
        """Middles (4, 3) of the feet from S, the body lifted [m]."""
        return np.column_stack([self._feet.mean(axis=1), np.full(LEG_COUNT, -self._lifted)])

    @cached_property
    def _places(self) -> FootPlaces:
        return foot_places(self.geometry.leg, _CELLS, _LEAN)

    # Size.

    @entry("Size", "mm")
    def length_mm(self) -> float:
        """Length over the feet, legs straight, along the way that it walks."""
        return 1e3 * float(np.ptp(self._feet[..., 1]))

    @entry("Size", "mm")
    def width_mm(self) -> float:
        """Width over the feet, legs straight."""
        return 1e3 * float(np.ptp(self._feet[..., 0]))

    @entry("Size", "m^2")
    def footprint_m2(self) -> float:
        """Area of ground between all corners of the feet, legs straight."""
        return float(ConvexHull(self._feet.reshape(-1, 2)).volume)

    @entry("Size", "mm")
    def lowest_seat_mm(self) -> float:
        """Lowest height of the seat above level ground, legs straight."""
        return 1e3 * (self._heights[0] + self.geometry.seat_height)

    @entry("Size", "mm")
    def highest_seat_mm(self) -> float:
        """Highest height of the seat above level ground, legs straight."""
        return 1e3 * (self._heights[1] + self.geometry.seat_height)

    @entry("Size", "mm")
    def walking_seat_mm(self) -> float:
        """Height of the seat while it walks."""
        return 1e3 * (self._lifted + self.geometry.seat_height)

    # Masses.

    @entry("Masses", "kg")
    def mass_kg(self) -> float:
        """Mass of the chair without a passenger."""
        return self.masses.total

    @entry("Masses", "kg")
    def leg_mass_kg(self) -> float:
        """Mass of a leg."""
        return self.masses.leg

    @entry("Masses", "mm")
    def centre_of_mass_mm(self) -> float:
        """Height of the centre of mass above level ground, lifted to walk, with the passenger."""
        _, centre = centre_of_mass(self.masses, self._passenger, self._middles)
        return 1e3 * (self._lifted + float(centre[2]))

    # Workspace.

    @entry("Workspace of a foot", "m^3")
    def foot_volume_m3(self) -> float:
        """Volume of places of a foot's middle, its leg leaning by up to 45 deg about each axis."""
        return float(self._places.volume.sum())

    foot_extent_x_mm, foot_extent_y_mm, foot_extent_z_mm = extents(
        "Workspace of a foot",
        ("Extent to the sides", "Extent along the way that it walks", "Extent upwards"),
        lambda sheet: sheet._places.place,
    )

    # Ground and gait.

    @entry("Ground and gait", "deg")
    def level_range_deg(self) -> float:
        """Largest inclination of ground, in any direction, on which it stands level."""
        azimuths = np.linspace(0.0, 2.0 * math.pi, _DIRECTIONS, endpoint=False)
        return math.degrees(level_range(self.geometry, azimuths).min())

    @entry("Ground and gait", "deg")
    def level_range_pitch_deg(self) -> float:
        """Largest inclination of ground that rises ahead or behind."""
        ahead = (0.5 * math.pi, -0.5 * math.pi)
        return math.degrees(level_range(self.geometry, ahead).min())

    @entry("Ground and gait", "deg")
    def level_range_roll_deg(self) -> float:
        """Largest inclination of ground that rises to one side."""
        return math.degrees(level_range(self.geometry, (0.0, math.pi)).min())

    @entry("Ground and gait", "mm")
    def step_height_mm(self) -> float:
        """Highest step under any of its feet on which it stands level, legs straight."""
        return 1e3 * (self._heights[1] - self._heights[0])

    @entry("Ground and gait", "mm")
    def longest_step_mm(self) -> float:
        """Longest step within the strokes, at the gait's lift and height of swing."""
        return 1e3 * largest_size(self.geometry, lambda size: replace(self._gait, step=size))

    @entry("Ground and gait", "mm")
    def highest_swing_mm(self) -> float:
        """Greatest height over which a foot swings within the strokes, at the gait's step."""
        return 1e3 * largest_size(
            self.geometry, lambda size: replace(self._gait, swing_height=size)
        )

    @entry("Ground and gait", "mm/s")
    def walking_speed_mm_s(self) -> float:
        """Speed at which it walks the gait's steps, its fastest branch at its limit."""
        return 1e3 * self._gait.step / (3.0 * self._shortest_phase)

    @cached_property
    def _shortest_phase(self) -> float:
        """Duration of a phase in which the fastest branch reaches its limit [s]."""
        return self._gait.phase_duration * self.branch_speed_mm_s / self.branch_speed_limit_mm_s

    # Actuators.

    @cached_property
    def _stances(self) -> Stances:
        return walked_stances(self.geometry, self._walk)

    def _load(self, passenger: Passenger) -> float:
        """Largest force of a branch at rest in the gait [N]."""
        stiffness = self.scenario.machine.drives.stiffness
        forces = resting_forces(self._stances, passenger, self.masses, stiffness)
        return float(np.abs(forces).max())

    @entry("Branches", "N")
    def branch_load_N(self) -> float:
        """Largest force of a branch in the gait, with the passenger, branches yielding alike."""
        return self._load(self._passenger)

    @entry("Branches", "N")
    def branch_force_N(self) -> float:
        """Force that a branch's drive has."""
        return self.scenario.machine.drives.max_force_N

    @entry("Branches")
    def branch_reserve(self) -> float:
        """Force that a branch has, by the largest load."""
        return self.branch_force_N / self.branch_load_N

    @entry("Branches", "kg")
    def passenger_kg(self) -> float:
        """Heaviest passenger, seated as the usual one, whom its branches carry in the gait."""
        low, high = 0.0, _HEAVIEST * LEG_COUNT * self.branch_force_N / GRAVITY
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            carries = self._load(replace(self._passenger, mass=middle)) <= self.branch_force_N
            low, high = (middle, high) if carries else (low, middle)
        return low

    @entry("Branches", "mm/s")
    def branch_speed_mm_s(self) -> float:
        """Largest speed of a branch in the gait."""
        return 1e3 * gait_speed(self.geometry, self._gait)

    @entry("Branches", "mm/s")
    def branch_speed_limit_mm_s(self) -> float:
        """Speed that a branch's drive has."""
        return self.scenario.machine.drives.max_velocity_mm_s

    @entry("Branches")
    def branch_speed_reserve(self) -> float:
        """Speed that a branch has, by the largest one in the gait."""
        return self.branch_speed_limit_mm_s / self.branch_speed_mm_s

    # Support.

    @entry("Support", "mm")
    def support_margin_mm(self) -> float:
        """Smallest distance of the centre of mass from tipping in the gait, with the passenger."""
        support = GaitSupport(self.geometry, self._walk, self.masses)
        return 1e3 * float(support.margins(self._passenger).min())

    # Accuracy.

    @cached_property
    def _conditions(self) -> NDArray[np.float64]:
        return conditioning(foot_jacobian(self.geometry.leg, self._places.up))

    @cached_property
    def _stiffness(self) -> NDArray[np.float64]:
        """Stiffness (6, 6) of the lifted body about S, along its axes."""
        lengths = straight_lengths(self.geometry.leg, np.full(LEG_COUNT, self._lifted))
        return body_stiffness(self.geometry, lengths, self.scenario.machine.drives.stiffness)

    @entry("Conditioning and stiffness")
    def local_conditioning(self) -> float:
        """Local conditioning index of a leg that hangs straight at work: 1 is isotropic."""
        up = (self._lifted - self.geometry.leg.x1 - self.geometry.leg.x2, 0.0, 0.0)
        return float(conditioning(foot_jacobian(self.geometry.leg, up)))

    @entry("Conditioning and stiffness")
    def global_conditioning(self) -> float:
        """Global conditioning index of a leg: mean of the local one over a foot's workspace."""
        return float(np.average(self._conditions, weights=self._places.volume))

    @entry("Conditioning and stiffness")
    def least_conditioning(self) -> float:
        """Smallest local conditioning index in that workspace: its distance from a singularity."""
        return float(self._conditions.min())

    @entry("Conditioning and stiffness", "mm")
    def characteristic_length_mm(self) -> float:
        """Characteristic length, which makes angles lengths: mean distance of the feet from S."""
        return 1e3 * self._length

    @cached_property
    def _length(self) -> float:
        return float(np.linalg.norm(self._middles[:, :2], axis=1).mean())

    @entry("Conditioning and stiffness")
    def body_conditioning(self) -> float:
        """Local conditioning index of the body on four feet, lifted to walk."""
        scale = np.repeat((1.0, 1.0 / self._length), 3)
        scaled = scale[:, np.newaxis] * self._stiffness * scale
        return math.sqrt(float(conditioning(scaled)))

    @entry("Conditioning and stiffness", "mm")
    def deflection_mm(self) -> float:
        """Displacement of the seat under the wrench, by the branches' drives."""
        seat = np.array((0.0, 0.0, self.geometry.seat_height))
        force, moment = np.array(self.wrench[:3]), np.array(self.wrench[3:])
        about_centre = np.concatenate((force, moment + np.cross(seat, force)))
        moved = np.linalg.solve(self._stiffness, about_centre)
        return 1e3 * float(np.linalg.norm(moved[:3] + np.cross(moved[3:], seat)))

    # What is drawn and listed.

    def signals(self) -> dict[str, NDArray[np.float64]]:
        """Lowered, as it begins to walk."""
        return {"legs.position": starting_lengths(self.geometry, self._walk).ravel()}

    def demonstrations(self) -> Iterator[Demonstration]:
        """Walk almost as fast as the branches do, and with almost the longest steps."""
        usual = self._demonstrate("walking_speed_mm_s", self._gait)
        longest = replace(self._gait, step=_TRIED * 1e-3 * self.longest_step_mm)
        yield from (usual, self._demonstrate("longest_step_mm", longest))

    def _demonstrate(self, name: str, gait: TrotGait) -> Demonstration:
        """A walk in a gait that takes its branches almost to their speed."""
        speed = 1e3 * gait_speed(self.geometry, gait)
        duration = gait.phase_duration * speed / (_TRIED * self.branch_speed_limit_mm_s)
        step = 1e3 * gait.step
        settings = {"gait.phase_duration": duration, "gait.step_mm": step}
        return Demonstration(name, settings, f"with {step:.3g} mm in phases of {duration:.3g} s")

    def dimensions(self) -> Iterator[Dimension]:
        """Distances of feet and legs, heights of the body and the seat."""
        lift = self.geometry.leg.retracted_height
        legs = np.array([(place.x, place.y, lift) for place in self.geometry.placements])
        feet = np.column_stack([self._feet.mean(axis=1), np.zeros(LEG_COUNT)])
        hinges = np.add(self.geometry.p_SA, (0.0, 0.0, lift))
        yield Dimension("plan", legs[3].tolist(), legs[2].tolist(), "legs")
        yield Dimension("plan", legs[0].tolist(), legs[3].tolist(), "legs")
        yield Dimension("plan", hinges[0].tolist(), hinges[3].tolist(), "hinges")
        yield Dimension("elevation", feet[0].tolist(), legs[0].tolist(), "S")
        seat = (float(legs[0, 0]), 0.0, lift + self.geometry.seat_height)
        yield Dimension("elevation", (seat[0], 0.0, 0.0), seat, "seat")

    def tables(self) -> Iterator[Table]:
        """Dimensions of the legs, and their places."""
        leg = self.geometry.leg
        rows: list[list[str | float]] = [
            ["upper platform a", 1e3 * leg.a],
            ["lower platform b", 1e3 * leg.b],
            ["UP branch l_11", _range(leg.up_stroke)],
            ["UPS branches l_12, l_13", _range(leg.ups_stroke)],
            ["actuators", _range((leg.actuator_min, leg.actuator_max))],
        ]
        yield Table("Each leg", ("length", "[mm]"), rows)
        columns = ("leg", "x [mm]", "y [mm]", "UP branch")
        yield Table("Places of the legs", columns, [
            [str(i), 1e3 * place.x, 1e3 * place.y, "rearmost" if place.turned else "foremost"]
            for i, place in enumerate(self.geometry.placements, start=1)
        ])  # fmt: skip

    def figures(self) -> Iterator[Figure]:
        """Ground on which it stands level by direction, and the workspace of a foot."""
        yield Figure(
            "level_range",
            "Ground on which it stands level",
            "Largest inclination [deg] by the direction in which the ground rises; y points "
            "ahead.",
            self._draw_ranges,
            (3.6, 3.6),
        )
        yield Figure(
            "foot_workspace",
            "Workspace of a foot",
            "Places of a foot's middle about the hinge of its UP branch [mm]: from the side and "
            "from behind. A point marks where it hangs at work.",
            self._draw_feet,
            (7.2, 3.4),
        )

    def _draw_ranges(self, canvas: "Canvas") -> None:
        axes = polar_axes(canvas)
        azimuths = np.linspace(0.0, 2.0 * math.pi, 4 * _DIRECTIONS + 1)
        ranges = np.degrees(level_range(self.geometry, azimuths))
        axes.plot(azimuths, ranges, color=COLOURS[0])
        axes.set_ylim(0.0)

    def _draw_feet(self, canvas: "Canvas") -> None:
        leg = self.geometry.leg
        hanging = np.array((*leg.corners.mean(axis=0)[:2], -self._lifted))
        sides: Any = canvas.subplots(1, 2)
        for axes, across, name in zip(sides, (1, 0), "yx", strict=True):
            flat = 1e3 * self._places.place[:, [across, 2]]
            # One pale blue wherever there is a place.
            ones = np.ones(len(flat))
            axes.hexbin(*flat.T, ones, gridsize=(20, 12), cmap="Blues", vmin=0.0, vmax=2.5)
            axes.plot(*(1e3 * hanging[[across, 2]]), "k.")
            axes.grid(False)
            axes.set(xlabel=f"{name} [mm]", ylabel="z [mm]", aspect="equal")


def _range(ends: tuple[float, float]) -> str:
    low, high = (1e3 * end for end in ends)
    return f"{low:g} to {high:g}"
