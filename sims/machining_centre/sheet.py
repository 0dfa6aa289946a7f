"""Data sheet of a machining centre: what follows from its dimensions, masses and drives."""

import math
from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull  # type: ignore[import-untyped]

from parapod.diagrams.machining_centre.scenario import CentreScenario
from parapod.diagrams.style import COLOURS
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
from parapod.systems.core.vectors import rotation_columns
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import Process, carried, standing
from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.platform_mode import legs_at
from parapod.systems.machining_centre.posture import Posture
from parapod.systems.machining_centre.ranges import (
    Places,
    drill_range,
    drilling_poses,
    holding_forces,
    platform_places,
    scaled_jacobian,
    tilt_range,
    upright_heights,
)
from parapod.systems.machining_centre.statics import CentreMasses

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Directions on the panel that are looked at, and places along each.
_DIRECTIONS, _ALONG = 48, 8
_AZIMUTHS = np.linspace(0.0, 2.0 * math.pi, _DIRECTIONS, endpoint=False)
# Cells along each edge of the workspace.
_CELLS = 32
# Share of a limit that is tried with rigid bodies.
_TRIED = 0.9


class CentreSheet(Sheet[CentreScenario, CentreGeometry, CentreMasses]):
    """Data sheet of a centre that stands on the panel and drills with the process of its scenario.

    The wrench acts at the drill's tip, on the panel amid the feet.
    """

    usual_wrench: ClassVar[Wrench] = (50.0, 0.0, 150.0, 0.0, 0.0, 0.6)
    highlights = (
        "mass_kg", "drill_reach_mm", "tilt_deg", "thrust_N", "leg_reserve", "deflection_mm",
    )  # fmt: skip

    # Parts of the machine that entries share.

    @cached_property
    def _panel(self) -> Panel:
        radius = 1e-3 * self.scenario.panel.radius_mm
        return Panel(radius if radius > 0.0 else math.inf, self.geometry.foot_height)

    @cached_property
    def _process(self) -> Process:
        return Process(
            tool_length=self.geometry.tool_length,
            thrust=self.scenario.process.thrust_N,
            torque=self.scenario.process.torque_Nm,
            largest_leg_force=self.leg_force_N,
            masses=self.masses,
        )

    @cached_property
    def _posture(self) -> Posture:
        """Posture at home, with the drill's tip on the panel amid the feet."""
        return standing(self.geometry, self._panel, self.geometry.tool_length)

    @cached_property
    def _heights(self) -> tuple[float, float]:
        return upright_heights(self.geometry)

    @cached_property
    def _places(self) -> Places:
        return platform_places(self.geometry, _CELLS)

    @cached_property
    def _drilled(self) -> NDArray[np.float64]:
        """Farthest places (k) that the upright drill reaches on the panel, by azimuth [m]."""
        return drill_range(self.geometry, self._panel, _AZIMUTHS)

    @cached_property
    def _drilling(self) -> NDArray[np.float64]:
        """Poses (n, 6) of the platform with the drill's tip wherever it reaches on the panel."""
        shares = np.linspace(0.0, 1.0 - 1e-9, _ALONG)[:, np.newaxis]
        ways = shares * self._drilled
        poses = drilling_poses(
            self._panel,
            ways * np.cos(_AZIMUTHS),
            ways * np.sin(_AZIMUTHS),
            self.geometry.tool_length,
        )
        return poses.reshape(-1, 6)

    # Size.

    @entry("Size", "mm")
    def diameter_mm(self) -> float:
        """Diameter of the circle about the feet at home."""
        return 1e3 * (2.0 * self.geometry.pattern_radius + self.geometry.foot_diameter)

    @entry("Size", "m^2")
    def footprint_m2(self) -> float:
        """Area between the ankles at home."""
        return float(ConvexHull(self.geometry.footholds[:, :2]).volume)

    @entry("Size", "mm")
    def lowest_height_mm(self) -> float:
        """Lowest height of the upright platform's pivots above the ground."""
        return 1e3 * (self._heights[0] + self.geometry.foot_height)

    @entry("Size", "mm")
    def highest_height_mm(self) -> float:
        """Highest height of the upright platform's pivots above the ground."""
        return 1e3 * (self._heights[1] + self.geometry.foot_height)

    # Masses.

    @entry("Masses", "kg")
    def mass_kg(self) -> float:
        """Mass of all: platform, tool and limbs."""
        return self.masses.platform + self.geometry.limbs * self.masses.limb

    @entry("Masses", "kg")
    def platform_mass_kg(self) -> float:
        """Mass of the platform with its spindle and tool."""
        return self.masses.platform

    @entry("Masses", "kg")
    def limb_mass_kg(self) -> float:
        """Mass of a limb: mount, hinge, two legs, ankle and foot."""
        return self.masses.limb

    @entry("Masses", "mm")
    def centre_of_mass_mm(self) -> float:
        """Height of the centre of mass above the panel as it drills, each limb's in its middle."""
        top, foot = self.geometry.tool_length, self.geometry.foot_height
        limbs = self.geometry.limbs * self.masses.limb
        return 1e3 * (self.masses.platform * top + limbs * 0.5 * (top + foot)) / self.mass_kg

    # Workspace.

    @entry("Workspace of the platform", "m^3")
    def platform_volume_m3(self) -> float:
        """Volume that the upright platform's middle reaches, feet at home on a plane."""
        return len(self._places.place) * self._places.volume

    platform_extent_x_mm, platform_extent_y_mm, platform_extent_z_mm = extents(
        "Workspace of the platform",
        ("Extent along x, towards limb 1", "Extent along y", "Extent upwards"),
        lambda sheet: np.stack((sheet._places.low, sheet._places.high)),
    )

    # Panels.

    @entry("Panel and drill", "m^2")
    def drill_area_m2(self) -> float:
        """Area of the panel, feet at home, into which it drills along the panel's normals."""
        return 0.5 * float((self._drilled**2).mean()) * 2.0 * math.pi

    @entry("Panel and drill", "mm")
    def drill_reach_mm(self) -> float:
        """Distance from amid the feet within which it drills everywhere along the normals."""
        return 1e3 * float(self._drilled.min())

    @entry("Panel and drill", "deg")
    def tilt_deg(self) -> float:
        """Largest tilt of a hole amid the feet, in every direction."""
        return math.degrees(tilt_range(self.geometry, self._panel, _AZIMUTHS).min())

    @entry("Panel and drill", "mm")
    def depth_mm(self) -> float:
        """Depth to which the drill goes into a plane panel amid the feet."""
        return 1e3 * (self.geometry.tool_length - self.geometry.foot_height - self._heights[0])

    # Actuators.

    @cached_property
    def _loads(self) -> NDArray[np.float64]:
        """Forces (2, n, 2n) of the legs, without the drill and with it, wherever it drills [N]."""
        geometry, feet = self.geometry, self._posture.feet
        out = np.stack(rotation_columns(*self._drilling[:, 3:].T)[2], axis=-1)
        drill = np.hstack((self._process.torque * out, self._process.thrust * out))
        wrenches = self.masses.weight(geometry) + np.stack((0.0 * drill, drill))
        return holding_forces(geometry, self._drilling, feet, wrenches)

    @entry("Legs", "N")
    def leg_load_N(self) -> float:
        """Largest force of a leg by the weight, and by drill and weight, wherever it drills."""
        return float(np.abs(self._loads).max())

    @entry("Legs", "N")
    def leg_force_N(self) -> float:
        """Force that a leg's drive has."""
        return self.scenario.machine.legs.max_force_N

    @entry("Legs")
    def leg_reserve(self) -> float:
        """Force that a leg has, by the largest load."""
        return self.leg_force_N / self.leg_load_N

    @entry("Legs", "mm/s")
    def leg_speed_mm_s(self) -> float:
        """Largest speed of a leg while the platform moves and turns at its largest speeds."""
        speeds = self.scenario.motion.speeds
        return 1e3 * (speeds.rapid + speeds.turn * self._arm)

    @entry("Legs", "mm/s")
    def leg_speed_limit_mm_s(self) -> float:
        """Speed that a leg's drive has."""
        return self.scenario.machine.legs.max_velocity_mm_s

    @entry("Legs")
    def leg_speed_reserve(self) -> float:
        """Speed that a leg has, by the largest one at work."""
        return self.leg_speed_limit_mm_s / self.leg_speed_mm_s

    @entry("Legs", "deg/s")
    def turn_rate_deg_s(self) -> float:
        """Rate at which it turns about any axis, wherever it drills, by the legs' speed."""
        return math.degrees(1e-3 * self.leg_speed_limit_mm_s / self._arm)

    @cached_property
    def _arm(self) -> float:
        """Largest arm of a leg about P_O, wherever it drills: its speed by a turn [m]."""
        legs = legs_at(self.geometry, self._drilling, self._posture.feet)
        return float(np.linalg.norm(np.cross(legs.arms, legs.directions, axis=1), axis=1).max())

    # Wrenches.

    @entry("Wrenches amid the feet", "N")
    def wrench_capacity_N(self) -> float:
        """Force that is resisted in every direction, moments divided by the platform's radius."""
        return carried(self.geometry, self._process, *self._posture).capacity

    @entry("Wrenches amid the feet")
    def wrench_index(self) -> float:
        """Wrench index w_minmax: that force by all that the legs have together."""
        return carried(self.geometry, self._process, *self._posture).w_minmax

    @entry("Wrenches amid the feet", "N")
    def thrust_N(self) -> float:
        """Largest thrust there with the process's torque, the weight wherever it is worst."""
        moment = self._process.torque / self.geometry.platform_radius
        weight = float(np.linalg.norm(self.masses.weight(self.geometry)))
        return math.sqrt(max(0.0, self.wrench_capacity_N**2 - moment**2)) - weight

    # Accuracy.

    @cached_property
    def _singular(self) -> NDArray[np.float64]:
        """Singular values (n, 6) of the Jacobian in the workspace, angles as lengths [-]."""
        jacobians = scaled_jacobian(self.geometry, self._places.poses)
        return np.linalg.svd(jacobians, compute_uv=False)

    @entry("Conditioning and stiffness", "mm")
    def characteristic_length_mm(self) -> float:
        """Characteristic length, which makes angles lengths: radius of the platform's pivots."""
        return 1e3 * self.geometry.platform_radius

    @entry("Conditioning and stiffness")
    def local_conditioning(self) -> float:
        """Local conditioning index while it drills amid the feet: 1 is isotropic, 0 singular."""
        return float(conditioning(scaled_jacobian(self.geometry, *self._posture)))

    @entry("Conditioning and stiffness")
    def global_conditioning(self) -> float:
        """Global conditioning index: mean of the local one over the platform's workspace."""
        return float((self._singular[:, -1] / self._singular[:, 0]).mean())

    @entry("Conditioning and stiffness")
    def least_conditioning(self) -> float:
        """Smallest local conditioning index in that workspace."""
        return float((self._singular[:, -1] / self._singular[:, 0]).min())

    @entry("Conditioning and stiffness")
    def least_singular(self) -> float:
        """Smallest singular value in that workspace: its distance from a singularity."""
        return float(self._singular[:, -1].min())

    @entry("Conditioning and stiffness", "mm")
    def deflection_mm(self) -> float:
        """Displacement of the drill's tip under the wrench, by the legs' drives."""
        return 1e3 * float(np.linalg.norm(self._displacement))

    @entry("Conditioning and stiffness", "mm")
    def sinking_mm(self) -> float:
        """Part of that displacement along the drill."""
        return 1e3 * abs(float(self._displacement[2]))

    @cached_property
    def _displacement(self) -> NDArray[np.float64]:
        """Displacement (3) of the drill's tip under the wrench, amid the feet [m]."""
        geometry, (pose, feet) = self.geometry, self._posture
        scale = np.repeat((geometry.platform_radius, 1.0), 3)
        rows = scaled_jacobian(geometry, pose, feet) * scale
        force, moment = np.array(self.wrench[:3]), np.array(self.wrench[3:])
        tip = np.array((0.0, 0.0, -geometry.tool_length))
        wrench = np.concatenate((moment + np.cross(tip, force), force))
        stiffness = 1e6 * self.scenario.machine.legs.stiffness_N_um * rows.T @ rows
        turned, moved = np.split(np.linalg.solve(stiffness, wrench), 2)
        return np.asarray(moved + np.cross(turned, tip))

    # What is drawn and listed.

    def signals(self) -> dict[str, NDArray[np.float64]]:
        """Posture at home, the drill's tip on the panel amid the feet."""
        pose, feet = self._posture
        return {"pose_estimated": pose, "feet_estimated": feet.ravel()}

    def demonstrations(self) -> Iterator[Demonstration]:
        """A hole amid the feet with almost the largest thrust."""
        thrust = _TRIED * self.thrust_N
        yield Demonstration(
            "thrust_N",
            {"process.thrust_N": thrust, "holes.count": 1, "holes.tilt_deg": 0.0},
            f"with one hole and a thrust of {thrust:.3g} N",
        )

    def dimensions(self) -> Iterator[Dimension]:
        """Radii of pivots and feet, and heights of platform and ankles."""
        pose, feet = self._posture
        pivots = self.geometry.pivots + pose[:3]
        middle = (0.0, 0.0, float(pose[2]))
        first = feet[0, :3].tolist()
        yield Dimension("plan", middle, first, "feet r")
        out = (self.geometry.platform_radius, 0.0, float(pose[2]))
        yield Dimension("plan", middle, out, "pivots r")
        left, right = pivots[0].tolist(), pivots[1].tolist()
        yield Dimension("plan", left, right, "pivots")
        yield Dimension("elevation", (0.0, 0.0, 0.0), middle, "P_O")

    def tables(self) -> Iterator[Table]:
        """Dimensions of platform, feet and legs."""
        geometry = self.geometry
        rows: list[list[str | float]] = [
            ["limbs", geometry.limbs],
            ["angle of a limb's middle to its pivots [deg]", math.degrees(geometry.half_angle)],
            ["radius of the pivots [mm]", 1e3 * geometry.platform_radius],
            ["radius of the feet at home [mm]", 1e3 * geometry.pattern_radius],
            ["shortest leg [mm]", 1e3 * geometry.stroke_min],
            ["longest leg [mm]", 1e3 * geometry.stroke_max],
            ["drill's tip below the pivots [mm]", 1e3 * geometry.tool_length],
            ["ankles above the panel [mm]", 1e3 * geometry.foot_height],
        ]
        yield Table("Dimensions", ("dimension", "value"), rows)

    def figures(self) -> Iterator[Figure]:
        """Panel that it drills, tilts of a hole, and the workspace."""
        yield Figure(
            "drill_range",
            "Panel that it drills",
            "Places [mm] that the drill reaches along the panel's normals, feet at home (points).",
            self._draw_reach,
            (3.6, 3.6),
        )
        yield Figure(
            "tilt_range",
            "Tilt of a hole",
            "Largest tilt [deg] of a hole amid the feet, by the direction in which it leans.",
            self._draw_tilt,
            (3.6, 3.6),
        )

    def _draw_reach(self, canvas: "Canvas") -> None:
        axes: Any = canvas.add_subplot()
        around = np.append(_AZIMUTHS, 2.0 * math.pi)
        way = 1e3 * np.append(self._drilled, self._drilled[0])
        axes.fill(way * np.cos(around), way * np.sin(around), color="#9FB8CE")
        axes.plot(way * np.cos(around), way * np.sin(around), color="#5B7083", linewidth=1.0)
        axes.plot(*(1e3 * self.geometry.footholds[:, :2].T), "k.")
        axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")

    def _draw_tilt(self, canvas: "Canvas") -> None:
        axes = polar_axes(canvas)
        around = np.append(_AZIMUTHS, 2.0 * math.pi)
        tilts = np.degrees(tilt_range(self.geometry, self._panel, around))
        axes.plot(around, tilts, color=COLOURS[0])
        axes.set_ylim(0.0)
