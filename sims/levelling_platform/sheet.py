"""Data sheet of the levelling platform: what follows from its dimensions, masses and motors."""

import math
from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull  # type: ignore[import-untyped]

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
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
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import (
    forward_kinematics,
    height_range,
    inverse_kinematics,
    posture_jacobian,
)
from parapod.systems.levelling_platform.plane import normal_of
from parapod.systems.levelling_platform.ranges import (
    foot_stiffness_matrix,
    ground_of,
    highest_step,
    level_range,
    tilt_range,
)
from parapod.systems.levelling_platform.statics import KinematicPlatformParams, stand
from parapod.systems.levelling_platform.turntable import stability_margin
from parapod.systems.levelling_platform.workspace import (
    ArmGeometry,
    PostureGrid,
    Workspace,
    boundary,
    posture_grid,
    tips_and_volumes,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

_LEVEL = (0.0, 0.0)
# Directions in which ground and platform are inclined, turns of the turntable that are looked at.
_DIRECTIONS, _TURNS = 48, 24
# Cells along each axis of the workspace, and points along an edge of one of its faces.
_CELLS, _EDGE = 24, 9
# Share of the steepest ground on which rigid bodies are tried [-].
_TRIED = 0.96
_LONG_WAY = 20.0  # time after which it is level on that ground [s]
# Leans of the arm that are looked at [rad].
_LEANS = np.radians(np.arange(0.0, 91.0, 5.0))


class PlatformSheet(Sheet[LevellingScenario, PlatformGeometry, KinematicPlatformParams]):
    """Data sheet of a platform.

    The wrench acts at the arm's tip, the arm upright.
    """

    usual_wrench: ClassVar[Wrench] = (50.0, 0.0, -100.0, 0.0, 0.0, 0.0)
    highlights = (
        "mass_kg", "level_range_deg", "step_mm", "footprint_m2", "actuator_reserve",
        "support_margin_mm",
    )  # fmt: skip

    # Parts of the machine that entries share.

    @cached_property
    def _height(self) -> float:
        return self.scenario.machine.working_height

    @cached_property
    def _arm(self) -> ArmGeometry:
        return self.scenario.machine.reach

    @cached_property
    def _feet(self) -> NDArray[np.float64]:
        """Feet (4, 2) about F, level at the working height [m]."""
        return self.scenario.machine.stance

    @cached_property
    def _azimuths(self) -> NDArray[np.float64]:
        return np.linspace(0.0, 2.0 * math.pi, _DIRECTIONS, endpoint=False)

    @cached_property
    def _level_ranges(self) -> NDArray[np.float64]:
        return level_range(self.geometry, self._azimuths)

    @cached_property
    def _grid(self) -> PostureGrid:
        return posture_grid(self.geometry, _CELLS)

    @cached_property
    def _tips(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Tips (n, 3) [m] and the volumes (n) that they stand for [m^3]."""
        return tips_and_volumes(self.geometry, self._arm, self._grid)

    @cached_property
    def _length(self) -> float:
        """Characteristic length: mean distance of the feet from F, from above [m]."""
        return float(np.linalg.norm(self._feet, axis=1).mean())

    def _jacobians(self, posture: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rates of the extensions (..., 4, 3) by those of the posture, angles as lengths [-]."""
        jacobian = posture_jacobian(self.geometry, posture, _LEVEL)
        return jacobian / (self._length, self._length, 1.0)

    @cached_property
    def _conditions(self) -> NDArray[np.float64]:
        return conditioning(self._jacobians(self._grid.posture))

    # Size.

    @entry("Size", "mm")
    def length_mm(self) -> float:
        """Length over the feet, level at the working height."""
        return 1e3 * float(np.ptp(self._feet[:, 0]) + 2.0 * self.geometry.foot_radius)

    @entry("Size", "mm")
    def width_mm(self) -> float:
        """Width over the feet, level at the working height."""
        return 1e3 * float(np.ptp(self._feet[:, 1]) + 2.0 * self.geometry.foot_radius)

    @entry("Size", "m^2")
    def footprint_m2(self) -> float:
        """Area between the feet, level at the working height."""
        x, y = self._feet.T
        return 0.5 * float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)))

    @entry("Size", "mm")
    def working_height_mm(self) -> float:
        """Height of its centre F at work."""
        return 1e3 * self._height

    @entry("Size", "mm")
    def lowest_height_mm(self) -> float:
        """Lowest height of F, level on its legs."""
        return 1e3 * self.scenario.machine.level_heights[0]

    @entry("Size", "mm")
    def highest_height_mm(self) -> float:
        """Highest height of F, level on its legs."""
        return 1e3 * self.scenario.machine.level_heights[1]

    # Masses.

    @entry("Masses", "kg")
    def mass_kg(self) -> float:
        """Mass of all, arm and wheels included."""
        return self.masses.total

    @entry("Masses", "kg")
    def arm_mass_kg(self) -> float:
        """Mass of what the arm's joints move."""
        return self.masses.arm.mass

    @entry("Masses", "mm")
    def centre_of_mass_mm(self) -> float:
        """Height of the centre of mass above level ground at work, arm upright."""
        return 1e3 * (self._height + float(self._centre(0.0, np.zeros(1))[0, 2]))

    def _centre(self, lean: float, turn: NDArray[np.float64]) -> NDArray[np.float64]:
        """Centre of mass (n, 3) from F, with the arm at a lean and turns (n) [m]."""
        point = self.masses.centre_with(self.masses.arm.leaning(lean, turn))
        return np.stack(np.broadcast_arrays(*point, turn)[:3], axis=-1)

    # Ground.

    @entry("Ground and tilt", "deg")
    def level_range_deg(self) -> float:
        """Largest inclination of ground on which it stands level, whatever the direction."""
        return math.degrees(self._level_ranges.min())

    @entry("Ground and tilt", "deg")
    def level_range_roll_deg(self) -> float:
        """Largest inclination of ground that rises to one side."""
        return math.degrees(level_range(self.geometry, (0.5 * math.pi, -0.5 * math.pi)).min())

    @entry("Ground and tilt", "deg")
    def level_range_pitch_deg(self) -> float:
        """Largest inclination of ground that rises ahead or behind."""
        return math.degrees(level_range(self.geometry, (0.0, math.pi)).min())

    @entry("Ground and tilt", "mm")
    def step_mm(self) -> float:
        """Highest step under any one foot on which it stands level."""
        return 1e3 * highest_step(self.geometry)

    @entry("Ground and tilt", "deg")
    def tilt_deg(self) -> float:
        """Largest tilt on level ground at the working height, whatever the direction."""
        return math.degrees(tilt_range(self.geometry, self._azimuths, self._height).min())

    @entry("Ground and tilt", "mm")
    def clearance_mm(self) -> float:
        """Smallest distance of the drawn base from ground that it levels."""
        grounds = ground_of((1.0 - 1e-9) * self._level_ranges, self._azimuths)
        grounds = np.concatenate([grounds, np.zeros((1, 2))])
        heights = height_range(self.geometry, _LEVEL, grounds)[:, 0]
        normals = np.stack(normal_of(*grounds.T), axis=-1)
        corners = self.scenario.machine.structure.underside
        return 1e3 * float((heights[:, np.newaxis] + normals @ corners.T).min())

    # Workspace.

    @entry("Workspace of the arm's tip", "m^3")
    def tip_volume_m3(self) -> float:
        """Volume that the tip reaches on level ground by the legs alone, arm upright."""
        return float(self._tips[1].sum())

    tip_extent_x_mm, tip_extent_y_mm, tip_extent_z_mm = extents(
        "Workspace of the arm's tip",
        ("Extent along x", "Extent along y", "Extent along z"),
        lambda sheet: sheet._edge_tips,
    )

    @cached_property
    def _edge(self) -> NDArray[np.float64]:
        """Extensions (n, 4) on the workspace's faces [m]."""
        return boundary(self.geometry, _EDGE)

    @cached_property
    def _edge_tips(self) -> NDArray[np.float64]:
        return Workspace(self.geometry, self._arm).tip_of_extensions(self._edge)

    # Actuators.

    @cached_property
    def _loads(self) -> NDArray[np.float64]:
        """Loads of the actuators (n, 4) over the ground that it levels, and on level ground [N].

        The arm is upright, or lies to where it loads a leg most.
        """
        directions = self._azimuths[:: _DIRECTIONS // 12]
        inclination = np.append(self._level_ranges[:: _DIRECTIONS // 12], 0.0)
        grounds = ground_of((1.0 - 1e-9) * inclination, np.append(directions, 0.0))
        rows = []
        for ground in grounds:
            low, high = self._heights(ground)
            posture = (0.0, 0.0, 0.5 * (low + high))
            extension = inverse_kinematics(self.geometry, posture, ground, on_unreachable="nan")
            for lean, turn in ((0.0, 0.0), *((0.5 * math.pi, turn) for turn in directions)):
                stance = stand(
                    self.geometry,
                    self.masses,
                    extension.tolist(),
                    [0.0] * LEG_COUNT,
                    ground.tolist(),
                    list(self.masses.arm.leaning(lean, turn)),
                )
                rows.append(stance.load_force)
        return np.abs(np.array(rows))

    def _heights(self, ground: NDArray[np.float64]) -> tuple[float, float]:
        low, high = height_range(self.geometry, _LEVEL, ground).tolist()
        return low, high

    @entry("Actuators", "N")
    def actuator_load_N(self) -> float:
        """Largest load of an actuator on ground that it levels, the arm to any side."""
        return float(np.nanmax(self._loads))

    @entry("Actuators", "N")
    def actuator_force_N(self) -> float:
        """Load that an actuator lifts at its supply's voltage, friction and screw deducted."""
        params = self.scenario.machine.actuators.params
        driving = params.motor_constant * params.supply_voltage - params.coulomb_friction
        return driving * params.screw_efficiency

    @entry("Actuators")
    def actuator_reserve(self) -> float:
        """Force that an actuator has, by the largest load."""
        return self.actuator_force_N / self.actuator_load_N

    @entry("Actuators", "mm/s")
    def actuator_speed_mm_s(self) -> float:
        """Speed of an actuator that lifts the largest load at its supply's voltage."""
        spare = self.actuator_force_N - self.actuator_load_N
        params = self.scenario.machine.actuators.params
        return 1e3 * spare / params.screw_efficiency / params.viscous_friction

    @entry("Actuators", "mm/s")
    def lift_rate_mm_s(self) -> float:
        """Speed at which it rises, at the actuators' speed, where that is slowest."""
        return self.actuator_speed_mm_s / float(np.abs(self._rates[:, 2]).max())

    @entry("Actuators", "deg/s")
    def roll_rate_deg_s(self) -> float:
        """Rate at which it rolls, at the actuators' speed, where that is slowest."""
        return math.degrees(1e-3 * self.actuator_speed_mm_s / float(self._rates[:, 0].max()))

    @entry("Actuators", "deg/s")
    def pitch_rate_deg_s(self) -> float:
        """Rate at which it pitches, at the actuators' speed, where that is slowest."""
        return math.degrees(1e-3 * self.actuator_speed_mm_s / float(self._rates[:, 1].max()))

    @cached_property
    def _rates(self) -> NDArray[np.float64]:
        """Fastest extension (n, 3) by the rates of roll, pitch and height, over the workspace."""
        jacobian = posture_jacobian(self.geometry, self._grid.posture, _LEVEL)
        return np.abs(jacobian).max(axis=1)

    # Support.

    @entry("Support", "mm")
    def support_margin_mm(self) -> float:
        """Smallest distance of the centre of mass from tipping in the workspace, arm upright."""
        return 1e3 * self._support(0.0, 1)

    @entry("Support", "deg")
    def arm_lean_deg(self) -> float:
        """Lean of the arm, to any side, up to which it does not tip anywhere in the workspace."""
        margins = np.array([self._support(lean, _TURNS) for lean in _LEANS])
        tips = np.flatnonzero(margins < 0.0)
        if not len(tips):
            return math.degrees(_LEANS[-1])
        after = int(tips[0])
        if after == 0:
            return 0.0
        share = margins[after - 1] / (margins[after - 1] - margins[after])
        return math.degrees(_LEANS[after - 1] + share * (_LEANS[after] - _LEANS[after - 1]))

    def _support(self, lean: float, turns: int) -> float:
        """Smallest margin over the workspace's faces, and over turns of the arm [m]."""
        centres = self._centre(lean, np.linspace(0.0, 2.0 * math.pi, turns, endpoint=False))
        attitude = forward_kinematics(self.geometry, self._edge, _LEVEL)[:, :2]
        extension, attitude = self._edge[:, np.newaxis], attitude[:, np.newaxis]
        return float(stability_margin(self.geometry, extension, attitude, centres).min())

    # Accuracy.

    @entry("Conditioning and stiffness", "mm")
    def characteristic_length_mm(self) -> float:
        """Characteristic length, which makes angles lengths: mean distance of the feet from F."""
        return 1e3 * self._length

    @entry("Conditioning and stiffness")
    def local_conditioning(self) -> float:
        """Local conditioning index at work: 1 is isotropic, 0 singular."""
        return float(conditioning(self._jacobians(np.array([0.0, 0.0, self._height]))))

    @entry("Conditioning and stiffness")
    def global_conditioning(self) -> float:
        """Global conditioning index: mean of the local one over the workspace."""
        return float(np.average(self._conditions, weights=self._grid.cell))

    @entry("Conditioning and stiffness")
    def least_conditioning(self) -> float:
        """Smallest local conditioning index in the workspace: its distance from a singularity."""
        return float(self._conditions.min())

    @entry("Conditioning and stiffness", "deg")
    def parallelogram_deg(self) -> float:
        """Smallest angle between a parallelogram's sides: flat ones hold no load."""
        angles = []
        for leg in self.geometry.legs:
            for extension in (leg.extension_min, leg.extension_max):
                sides = leg.l_3**2 + leg.l_4**2 - extension**2
                angle = math.acos(max(-1.0, min(1.0, sides / (2.0 * leg.l_3 * leg.l_4))))
                angles.append(min(angle, math.pi - angle))
        return math.degrees(min(angles))

    @cached_property
    def _deflection(self) -> NDArray[np.float64]:
        """Displacement (3) of the arm's tip under the wrench, feet where they stand [m]."""
        machine = self.scenario.machine
        x, y, z = (float(value) for value in self._arm.p_FT)
        force, moment = np.array(self.wrench[:3]), np.array(self.wrench[3:])
        # Platform: it rolls and pitches about its feet, and sinks.
        arm = np.array([x, y, z + self._height])
        on_platform = np.append((moment + np.cross(arm, force))[:2], force[2])
        stiffness = foot_stiffness_matrix(self._feet, self.masses.foot_stiffness)
        roll, pitch, sunk = np.linalg.solve(stiffness, on_platform)
        by_platform = np.add(np.cross((roll, pitch, 0.0), arm), (0.0, 0.0, sunk))
        # Drives of the arm's joints.
        joints = self.masses.arm
        jacobian: NDArray[np.float64] = np.reshape(
            joints.tip_jacobian([0.0] * joints.count), (6, joints.count)
        )
        settings = machine.arm.drive_settings(joints.count)
        stiffnesses = np.array([drive.stiffness_Nm_rad for drive in settings])
        bent = jacobian.T @ np.concatenate([moment, force]) / stiffnesses
        return by_platform + jacobian[3:] @ bent

    @entry("Conditioning and stiffness", "mm")
    def deflection_mm(self) -> float:
        """Displacement of the arm's tip under the wrench, by the legs and the arm's drives."""
        return 1e3 * float(np.linalg.norm(self._deflection))

    # What is drawn and listed.

    def signals(self) -> dict[str, NDArray[np.float64]]:
        """Level at the working height."""
        posture = (0.0, 0.0, self._height)
        extension = inverse_kinematics(self.geometry, posture, _LEVEL)
        return {"legs.extension": extension, "attitude_estimated": np.zeros(2)}

    def demonstrations(self) -> Iterator[Demonstration]:
        """Ground almost as steep as it levels, in the direction in which that is least."""
        place = int(self._level_ranges.argmin())
        steep = _TRIED * self._level_ranges[place]
        ground = ground_of(steep, self._azimuths[place])
        roll, pitch = np.degrees(ground).tolist()
        settings = {
            "ground.roll_deg": roll,
            "ground.pitch_deg": pitch,
            "job.height_mm": 1e3 * float(np.mean(self._heights(ground))),
            # The way is long, and leaves no stroke for other postures.
            "job.settled_after": _LONG_WAY,
            "job.waypoints": [],
        }
        yield Demonstration(
            "level_range_deg", settings, f"on ground of {math.degrees(steep):.3g} deg"
        )

    def dimensions(self) -> Iterator[Dimension]:
        """Distances of feet and hips, and the working height."""
        geometry = self.geometry
        hips = np.array([(-leg.l_x, -leg.l_y, -leg.l_z) for leg in geometry.legs])
        feet = np.column_stack([self._feet, np.full(LEG_COUNT, -self._height)])
        lift = np.array([0.0, 0.0, self._height])
        yield Dimension("plan", (hips[3] + lift).tolist(), (hips[0] + lift).tolist(), "hips")
        yield Dimension("plan", (feet[3] + lift).tolist(), (feet[0] + lift).tolist(), "feet")
        yield Dimension("plan", (hips[0] + lift).tolist(), (hips[1] + lift).tolist(), "hips")
        yield Dimension("elevation", (0.0, 0.0, 0.0), (0.0, 0.0, self._height), "F")

    def tables(self) -> Iterator[Table]:
        """Dimensions of each leg."""
        columns = (
            "leg", "hip x [mm]", "hip y [mm]", "hip z [mm]", "yaw [deg]", "l_3 [mm]", "l_4 [mm]",
            "l_6 [mm]", "l_7 [mm]", "alpha [deg]", "extension [mm]",
        )  # fmt: skip
        rows: list[list[str | float]] = []
        for number, leg in enumerate(self.geometry.legs, start=1):
            lengths = (-leg.l_x, -leg.l_y, -leg.l_z)
            row: list[str | float] = [str(number), *(1e3 * length for length in lengths)]
            row.append(math.degrees(leg.beta))
            row += [1e3 * length for length in (leg.l_3, leg.l_4, leg.l_6, leg.l_7)]
            row.append(math.degrees(leg.alpha))
            row.append(f"{1e3 * leg.extension_min:g} to {1e3 * leg.extension_max:g}")
            rows.append(row)
        yield Table("Legs", columns, rows)

    def figures(self) -> Iterator[Figure]:
        """Ground that it levels by direction, and the load of its actuators over that."""
        yield Figure(
            "level_range",
            "Ground that it levels",
            "Largest inclination [deg] by the direction in which the ground's normal leans; x "
            "points ahead.",
            self._draw_ranges,
            (3.6, 3.6),
        )
        yield Figure(
            "tip_workspace",
            "Workspace of the arm's tip",
            "Places of the tip on level ground, arm upright: from the side and from behind, about "
            "the platform's centre [mm].",
            self._draw_tips,
            (7.2, 3.2),
        )

    def _draw_ranges(self, canvas: "Canvas") -> None:
        axes = polar_axes(canvas)
        azimuths = np.append(self._azimuths, 2.0 * math.pi)
        for colour, ranges, label in (
            (COLOURS[0], self._level_ranges, "levelled ground"),
            (COLOURS[1], tilt_range(self.geometry, self._azimuths, self._height), "tilt at work"),
        ):
            axes.plot(
                azimuths, np.degrees(np.append(ranges, ranges[0])), color=colour, label=label
            )
        axes.set_ylim(0.0)
        canvas.legend(loc="outside lower center", ncols=2)

    def _draw_tips(self, canvas: "Canvas") -> None:
        support = self._feet[1]
        tips = self._edge_tips - (-support[0], -support[1], 0.0)
        sides: Any = canvas.subplots(1, 2)
        for axes, across, name in zip(sides, (0, 1), "xy", strict=True):
            flat = 1e3 * tips[:, [across, 2]]
            hull = np.append(ConvexHull(flat).vertices, ConvexHull(flat).vertices[0])
            axes.fill(*flat[hull].T, color="#9FB8CE")
            axes.plot(*flat[hull].T, color="#5B7083", linewidth=1.0)
            axes.set(xlabel=f"{name} [mm]", ylabel="z [mm]", aspect="equal")
