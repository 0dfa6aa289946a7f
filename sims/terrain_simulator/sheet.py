"""Data sheet of the terrain simulator: what follows from its dimensions, masses and drives."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.style import COLOURS
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.sims.output.figures import Figure
from parapod.sims.sheet.sheet import (
    Demonstration,
    Dimension,
    Sheet,
    Table,
    Wrench,
    conditioning,
    entry,
)
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import (
    jacobian,
    singularity,
    slider_accelerations,
    slider_rates,
)
from parapod.systems.terrain_simulator.load_estimator import BenchMasses, drive_forces
from parapod.systems.terrain_simulator.path import PathLimits, PlatePath
from parapod.systems.terrain_simulator.printed import SPECIFICATION
from parapod.systems.terrain_simulator.ranges import (
    centre_height,
    holding_forces,
    largest_slope,
    largest_speed,
    largest_step,
    moving_mass,
    scaled_jacobian,
)
from parapod.systems.terrain_simulator.walk import BenchWalk
from parapod.systems.terrain_simulator.workspace import Box, Workspace, rail_interval, workspace

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Angles of a range that must all be possible, and heights of a workspace.
_ANGLES, _CELLS = 31, 400
# Range of angles of the boxes that entries name [rad].
_THIRTY = math.radians(30.0)
# Height of a box by the length of a link: 80 mm of 300 mm.
_TALL = 80.0 / 300.0
# Points along the edges of a box, and angles, at which loads and speeds are looked at.
_POINTS, _TURNS = 5, 25
# Instants of a stride that are looked at, and most strides.
_INSTANTS, _STRIDES = 240, 8
# Share of a limit that is tried with rigid bodies.
_TRIED = 0.97
_NOWHERE = Box(0.0, 0.0, 0.0, 0.0)


class BenchSheet(Sheet[TerrainBenchScenario, BenchGeometry, BenchMasses]):
    """Data sheet of a bench, with the leg, the gait and the terrain of its scenario.

    Its plate takes angles of 45 deg either way (pedal) or 14 deg (treadmill), as Table 1 asks.
    The wrench acts on the plate's middle, where it stands at the beginning of a walk; of its six
    components the bench moves under fx, fz and my.
    """

    usual_wrench: ClassVar[Wrench] = (100.0, 0.0, -600.0, 0.0, 0.0, 0.0)
    highlights = (
        "moving_mass_kg", "box_width_mm", "box_area_30_m2", "walking_speed_m_s", "slider_reserve",
        "box_load_N",
    )  # fmt: skip

    # Parts of the machine that entries share.

    @cached_property
    def _walk(self) -> BenchWalk:
        return self.scenario.walk

    @cached_property
    def _limits(self) -> PathLimits:
        """Limits of the drives and of the mechanism alone."""
        free = dict.fromkeys(("horizontal", "vertical", "turn"), math.inf)
        return replace(self.scenario.machine.sliders.limits, **free)

    @cached_property
    def _path(self) -> PlatePath:
        """Path of the walk, on the scenario's ground."""
        return replace(self._walk.path, phase=0.0)

    @cached_property
    def _pose(self) -> NDArray[np.float64]:
        """Pose (3) of the level plate in the middle of its place [m, m, rad]."""
        return np.array((self._path.x_c, self._path.z_c, 0.0))

    @cached_property
    def _most(self) -> float:
        """Angle of the plate either way [rad]."""
        belt = self.geometry.belt
        return SPECIFICATION.treadmill_angle if belt else SPECIFICATION.pedal_angle

    def _workspace(self, *angles: float) -> Workspace:
        least = self.scenario.machine.sliders.least_sin_mu
        return workspace(self.geometry, angles, least, _CELLS)

    @cached_property
    def _common(self) -> Workspace:
        """Places at which the plate takes all its angles."""
        return self._workspace(*np.linspace(-self._most, self._most, _ANGLES).tolist())

    @cached_property
    def _level(self) -> Workspace:
        return self._workspace(0.0)

    @cached_property
    def _box(self) -> Box:
        """Widest box, as tall as entries say, with all angles; without extent if there is none."""
        return self._common.widest_box(_TALL * self.geometry.link) or _NOWHERE

    @cached_property
    def _largest(self) -> Box:
        return self._common.largest_box() or _NOWHERE

    @cached_property
    def _largest_30(self) -> Box:
        angles = np.linspace(-_THIRTY, _THIRTY, _ANGLES).tolist()
        return self._workspace(*angles).largest_box() or _NOWHERE

    @cached_property
    def _poses(self) -> NDArray[np.float64]:
        """Poses (n, 3) in the widest box, at all angles; the walk's alone if there is no box."""
        box = self._box
        if not box.width > 0.0:
            return self._pose[np.newaxis]
        # Nothing but the sliders' places depends on x.
        heights = np.linspace(box.z_min, box.z_max, _POINTS)
        angles = np.linspace(-self._most, self._most, _TURNS)
        x = 0.5 * (box.x_min + box.x_max)
        axes = np.meshgrid(x, heights, angles, indexing="ij")
        return np.stack(axes, axis=-1).reshape(-1, 3)

    # Size.

    @entry("Size", "mm")
    def rail_mm(self) -> float:
        """Length of the rail between the ends of the sliders' ways."""
        return 1e3 * (self.geometry.slider_max - self.geometry.slider_min)

    @entry("Size", "mm")
    def lowest_plate_mm(self) -> float:
        """Lowest height of the level plate's middle above the rail."""
        return 1e3 * self._level.z_min

    @entry("Size", "mm")
    def highest_plate_mm(self) -> float:
        """Highest height of the level plate's middle above the rail."""
        return 1e3 * self._level.z_max

    @entry("Size", "mm")
    def walking_plate_mm(self) -> float:
        """Height of the plate's middle above the rail where it walks over level ground."""
        return 1e3 * self._path.z_c

    # Masses.

    @entry("Masses", "kg")
    def moving_mass_kg(self) -> float:
        """Mass of what moves: sliders, links, strut and plate with its tread."""
        return moving_mass(self.masses)

    @entry("Masses", "kg")
    def plate_mass_kg(self) -> float:
        """Mass of the plate with its tread."""
        return self.masses.plate.mass

    @entry("Masses", "mm")
    def centre_of_mass_mm(self) -> float:
        """Height of the centre of what moves above the rail, where it walks over level ground."""
        return 1e3 * centre_height(self.geometry, self.masses, self._path.z_c)

    # Workspace.

    @entry("Workspace of the plate", "m^2")
    def area_level_m2(self) -> float:
        """Area of places of the level plate's middle."""
        return self._level.area

    @entry("Workspace of the plate", "m^2")
    def area_up_m2(self) -> float:
        """Area of places with the front end up by all of its angle."""
        return self._workspace(-self._most).area

    @entry("Workspace of the plate", "m^2")
    def area_down_m2(self) -> float:
        """Area of places with the front end down by all of its angle."""
        return self._workspace(self._most).area

    @entry("Workspace of the plate", "m^2")
    def area_common_m2(self) -> float:
        """Area of places at which the plate takes all its angles."""
        return self._common.area

    @entry("Workspace of the plate", "mm")
    def extent_x_mm(self) -> float:
        """Longest way of the level plate along the rail at one height."""
        return 1e3 * self._level.width

    @entry("Workspace of the plate", "mm")
    def extent_z_mm(self) -> float:
        """Extent of the level plate's places upwards."""
        return 1e3 * (self._level.z_max - self._level.z_min)

    # Boxes.

    @entry("Boxes", "mm")
    def box_width_mm(self) -> float:
        """Width of the widest box, 4/15 of a link tall (80 of 300 mm), with all its angles."""
        return 1e3 * self._box.width

    @entry("Boxes", "m^2")
    def box_area_m2(self) -> float:
        """Area of the largest box in which the plate takes all its angles."""
        return self._largest.width * self._largest.height

    @entry("Boxes", "m^2")
    def box_area_30_m2(self) -> float:
        """Area of the largest box in which the plate takes all angles of 30 deg either way."""
        return self._largest_30.width * self._largest_30.height

    @entry("Boxes", "mm")
    def box_width_30_mm(self) -> float:
        """Width of that box."""
        return 1e3 * self._largest_30.width

    @entry("Boxes", "mm")
    def box_height_30_mm(self) -> float:
        """Height of that box."""
        return 1e3 * self._largest_30.height

    # Terrains.

    @entry("Terrains", "deg")
    def slope_up_deg(self) -> float:
        """Steepest slope that it plays uphill in the gait, by the drives."""
        return math.degrees(largest_slope(self.geometry, self._path, self._limits, 1.0))

    @entry("Terrains", "deg")
    def slope_down_deg(self) -> float:
        """Steepest slope that it plays downhill in the gait, by the drives."""
        return math.degrees(largest_slope(self.geometry, self._path, self._limits, -1.0))

    @entry("Terrains", "mm")
    def step_up_mm(self) -> float:
        """Highest single step up that it plays in the gait, by the drives."""
        return 1e3 * largest_step(self.geometry, self._path, self._limits, 1.0)

    @entry("Terrains", "mm")
    def step_down_mm(self) -> float:
        """Deepest single step down that it plays in the gait, by the drives."""
        return 1e3 * largest_step(self.geometry, self._path, self._limits, -1.0)

    @entry("Terrains", "m/s")
    def walking_speed_m_s(self) -> float:
        """Largest speed over the scenario's ground at the gait's rate, by the drives."""
        return largest_speed(self.geometry, self._path, self._limits)

    @entry("Terrains", "mm")
    def stride_mm(self) -> float:
        """Stride at that speed."""
        return 1e3 * self.walking_speed_m_s / self._path.gait.frequency

    @entry("Terrains", "mm")
    def stance_way_mm(self) -> float:
        """Longest way of a standing foot over level ground: of the pedal, or along the belt."""
        if self.geometry.belt:
            return 1e3 * self.geometry.plate
        least = self.scenario.machine.sliders.least_sin_mu
        return 1e3 * float(np.ptp(rail_interval(self.geometry, self._path.z_c, 0.0, least)))

    # Actuators.

    @cached_property
    def _motion(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Motion (n, 9) of the plate in the gait, and the foot's load (n, 3) on it."""
        gait = self._path.gait
        strides = min(self._walk.strides, _STRIDES)
        times = np.linspace(0.0, strides / gait.frequency, strides * _INSTANTS + 1)
        motion = self._path.at(times)
        force = self._walk.support.force(gait.frequency * times)
        aside = motion.foothold[:, 0, 0] - motion.pose[:, 0]
        load = np.stack((np.zeros_like(force), -force, aside * force), axis=-1)
        return np.hstack((motion.pose, motion.velocity, motion.acceleration)), load

    @entry("Sliders", "N")
    def slider_load_N(self) -> float:
        """Largest force of a slider's drive in the gait: leg, weight and inertia."""
        return float(np.abs(drive_forces(self.geometry, self.masses, *self._motion)).max())

    @entry("Sliders", "N")
    def slider_force_N(self) -> float:
        """Force that a slider's drive has."""
        return self.scenario.machine.sliders.max_force_N

    @entry("Sliders")
    def slider_reserve(self) -> float:
        """Force that a slider has, by the largest load."""
        return self.slider_force_N / self.slider_load_N

    @entry("Sliders", "m/s")
    def slider_speed_m_s(self) -> float:
        """Largest speed of a slider in the gait."""
        pose, velocity, _ = np.split(self._motion[0], 3, axis=1)
        return float(np.abs(slider_rates(self.geometry, pose, velocity)).max())

    @entry("Sliders", "m/s")
    def slider_speed_limit_m_s(self) -> float:
        """Speed that a slider's drive has."""
        return self.scenario.machine.sliders.max_velocity_m_s

    @entry("Sliders", "m/s^2")
    def slider_acceleration_m_s2(self) -> float:
        """Largest acceleration of a slider in the gait."""
        parts = np.split(self._motion[0], 3, axis=1)
        return float(np.abs(slider_accelerations(self.geometry, *parts)).max())

    @entry("Sliders", "m/s^2")
    def slider_acceleration_limit_m_s2(self) -> float:
        """Acceleration that a slider's drive has."""
        return self.scenario.machine.sliders.max_acceleration_m_s2

    @entry("Sliders", "N")
    def box_load_N(self) -> float:
        """Largest load down on the plate's middle at rest, in the widest box at all its angles."""
        down = np.array((0.0, -1.0, 0.0))
        own = holding_forces(self.geometry, self.masses, self._poses, np.zeros(3))
        by_load = holding_forces(self.geometry, self.masses, self._poses, down) - own
        # Either end of what the drive has, whichever the load comes to.
        ends = (np.sign(by_load) * self.slider_force_N - own) / by_load
        return float(ends.min())

    @entry("Sliders", "m/s")
    def box_vertical_m_s(self) -> float:
        """Vertical speed of the plate in the widest box, all its angles, by the sliders' speed."""
        return self.slider_speed_limit_m_s / self._fastest((0.0, 1.0, 0.0))

    @entry("Sliders", "deg/s")
    def box_turn_deg_s(self) -> float:
        """Rate at which the plate turns there, by the sliders' speed."""
        return math.degrees(self.slider_speed_limit_m_s / self._fastest((0.0, 0.0, 1.0)))

    def _fastest(self, twist: tuple[float, float, float]) -> float:
        """Largest speed of a slider in the box by a motion of the plate."""
        return float(np.abs(slider_rates(self.geometry, self._poses, np.array(twist))).max())

    # Accuracy.

    @entry("Conditioning and stiffness", "mm")
    def characteristic_length_mm(self) -> float:
        """Characteristic length, which makes angles lengths: distance of the pivots P and T."""
        return 1e3 * self.geometry.lever

    @entry("Conditioning and stiffness")
    def local_conditioning(self) -> float:
        """Local conditioning index where it walks over level ground: 1 is isotropic."""
        return float(conditioning(scaled_jacobian(self.geometry, self._pose)))

    @cached_property
    def _conditions(self) -> NDArray[np.float64]:
        return conditioning(scaled_jacobian(self.geometry, self._poses))

    @entry("Conditioning and stiffness")
    def global_conditioning(self) -> float:
        """Global conditioning index: mean of the local one over the widest box, all its angles."""
        return float(self._conditions.mean())

    @entry("Conditioning and stiffness")
    def least_conditioning(self) -> float:
        """Smallest local conditioning index there."""
        return float(self._conditions.min())

    @entry("Conditioning and stiffness")
    def least_sin_mu(self) -> float:
        """Least sine of the transmission angle in the gait: its distance from a singularity."""
        return float(singularity(self.geometry, self._motion[0][:, :3]).sin_mu.min())

    @entry("Conditioning and stiffness")
    def box_sin_mu(self) -> float:
        """Least sine of the transmission angle in the widest box, all its angles."""
        return float(singularity(self.geometry, self._poses).sin_mu.min())

    @cached_property
    def _displacement(self) -> NDArray[np.float64]:
        """Displacement (3) of the plate under the wrench where it walks [m, m, rad]."""
        J = jacobian(self.geometry, self._pose)
        f_x, _, f_z, _, m_y, _ = self.wrench
        # The base frame's y points into the page: it turns about it with its front end down.
        stiffness = 1e6 * self.scenario.machine.sliders.stiffness_N_um
        return np.asarray(J @ J.T @ np.array((f_x, f_z, m_y)) / stiffness)

    @entry("Conditioning and stiffness", "mm")
    def deflection_mm(self) -> float:
        """Displacement of the plate's middle under the wrench, by the sliders' drives."""
        return 1e3 * float(np.linalg.norm(self._displacement[:2]))

    @entry("Conditioning and stiffness", "deg")
    def deflection_deg(self) -> float:
        """Turn of the plate under the wrench."""
        return abs(math.degrees(float(self._displacement[2])))

    # What is drawn and listed.

    def signals(self) -> dict[str, NDArray[np.float64]]:
        """Standing, as a walk begins."""
        start = self._walk.at(0.0)
        pose = start.pose[0]
        stands = self.scenario.leg.under_test.reach(start.foot[0], float(pose[2]))
        return {
            "pose_estimated": pose,
            "hip.position": np.array([self._walk.hip[1]]),
            "leg.position": np.asarray(stands, dtype=float),
        }

    def demonstrations(self) -> Iterator[Demonstration]:
        """Walk almost as fast as the bench does, the plate within the speeds of Table 1."""
        limits = self.scenario.machine.sliders.limits
        speed = _TRIED * largest_speed(self.geometry, self._path, limits)
        yield Demonstration(
            "walking_speed_m_s",
            {"gait.speed_m_s": speed},
            f"at {speed:.3g} m/s, by the speeds of Table 1",
        )

    def dimensions(self) -> Iterator[Dimension]:
        """Lengths along the rail, and heights of the pivots and the plate."""
        geometry = self.geometry
        x, z, _ = self._pose.tolist()
        P, T = (np.add((x, z), pivot).tolist() for pivot in (geometry.p_OP, geometry.p_OT))
        rear, front = ((end, 0.0, 0.0) for end in (geometry.slider_min, geometry.slider_max))
        yield Dimension("plan", rear, front, "rail")
        for name, (ahead, height) in (("P", P), ("T", T)):
            yield Dimension("elevation", (ahead, 0.0, 0.0), (ahead, 0.0, height), name)
        hip = self._walk.hip
        yield Dimension("elevation", (hip[0], 0.0, 0.0), (hip[0], 0.0, hip[1]), "hip")

    def tables(self) -> Iterator[Table]:
        """Dimensions of links, plate and rail, and the boxes."""
        geometry = self.geometry
        rows: list[list[str | float]] = [
            ["links", 1e3 * geometry.link],
            ["strut", 1e3 * geometry.strut],
            ["lever P T", 1e3 * geometry.lever],
            ["plate", 1e3 * geometry.plate],
            ["rail from", 1e3 * geometry.slider_min],
            ["rail to", 1e3 * geometry.slider_max],
        ]
        yield Table("Dimensions", ("length", "[mm]"), rows)
        columns = ("box", "x from [mm]", "to [mm]", "z from [mm]", "to [mm]")
        degrees = math.degrees(self._most)
        boxes = {
            f"widest, +-{degrees:.0f} deg": self._box,
            f"largest, +-{degrees:.0f} deg": self._largest,
            "largest, +-30 deg": self._largest_30,
        }
        yield Table("Boxes", columns, [
            [name, *(1e3 * end for end in box)] for name, box in boxes.items() if box.width > 0.0
        ])  # fmt: skip

    def figures(self) -> Iterator[Figure]:
        """Workspaces by the plate's angle, and the boxes."""
        yield Figure(
            "plate_workspace",
            "Workspace of the plate",
            "Places of the plate's middle along the rail and above it: level, with its front end "
            "up and down by all of its angle, and the boxes at all angles.",
            self._draw_workspace,
            (7.2, 3.4),
        )

    def _draw_workspace(self, canvas: "Canvas") -> None:
        axes: Any = canvas.add_subplot()
        degrees = math.degrees(self._most)
        for colour, angle, name in (
            (COLOURS[0], 0.0, "level"),
            (COLOURS[1], -self._most, f"front up by {degrees:.0f} deg"),
            (COLOURS[2], self._most, f"front down by {degrees:.0f} deg"),
        ):
            area = self._workspace(angle)
            if not area.is_empty:
                z, ends = 1e3 * area.z, 1e3 * area.ends
                axes.fill_betweenx(z, *ends.T, color=colour, alpha=0.3, lw=0, label=name)
        boxes = ((self._box, "-", "widest box"), (self._largest_30, ":", "largest at +-30 deg"))
        for box, style, name in boxes:
            if box.width > 0.0:
                x, z = 1e3 * np.array(box[:2]), 1e3 * np.array(box[2:])
                axes.plot(x[[0, 1, 1, 0, 0]], z[[0, 0, 1, 1, 0]], f"k{style}", lw=1.0, label=name)
        axes.set(aspect="equal", xlabel="x [mm]", ylabel="z [mm]")
        canvas.legend(loc="outside right center")
