"""Measure where the bench's plate reaches, and what Table 1 asks of it, beside Table 2.

Section 4 of the paper, exact: nothing is simulated. At a height and an angle the places along the
rail are one interval in closed form, so that areas converge with the square of the cells.

| | pedal | treadmill |
|---|---|---|
| area at -45, 0, +45 deg (treadmill: 14) [m^2] | .1276, .1040, .0704 | .1362, .1512, .0871 |
| with sin mu >= .25 [m^2] | .1276, .1040, .0402 | .1141, .1089, .0871 |
| widest box 80 mm high, at all angles | 367 mm | 457 mm |

Table 1 asks for 500 x 200 mm: 500 mm along the rail are possible in every orientation, 200 mm
upwards in four of six, both at once in none. alpha = 33 deg is the largest whole angle with which
A_3 keeps 100 mm from A_2 while the pedal's front end is up by 45 deg.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from parapod.diagrams.style import COLOURS
from parapod.sims.lab.experiment import Experiment
from parapod.sims.lab.runner import Runner
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import (
    LIMITS,
    jacobian,
    margins,
    slider_rates,
)
from parapod.systems.terrain_simulator.printed import OFFSET_DEG, SPECIFICATION
from parapod.systems.terrain_simulator.workspace import Box, Workspace, workspace

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Benches, and the angle either way that Table 1 asks of each [rad].
BENCHES = {
    "pedal": (BenchGeometry.pedal(), SPECIFICATION.pedal_angle),
    "treadmill": (BenchGeometry.treadmill(), SPECIFICATION.treadmill_angle),
}
# Orientations of Fig. 6, by the sign of phi.
WAYS = {"up": -1.0, "level": 0.0, "down": 1.0}
# Angles of a range that must all be possible, and points along the edges of a box.
_ANGLES, _POINTS = 91, 9
# Heights at which the distance of A_2 and A_3 is looked at.
_ALONG = 1000
# Largest relative change of an area when its cells are halved.
_CONVERGED = 1e-3
_GAP = LIMITS.index("gap of A_2 and A_3")


@dataclass
class BenchWorkspaceScenario(Schema):
    """Limits within which workspaces are computed; both benches are those of Table 2.

    Attributes:
        backend: method: "exact", closed forms.
        seed: seed, which changes nothing: nothing is random.
        least_sin_mu: least sine of the transmission angle between plate and strut [-]: at 0 they
            are in line, and the plate turns under the least load.
        box_height_mm: height of the boxes that are possible at all angles [mm].
        cells: number of heights at which a workspace is computed.
    """

    backend: str = choice("exact", ("exact",))
    seed: int = quantity(0, 0, 2**31 - 1)
    least_sin_mu: float = quantity(0.25, 0.0, 0.9)
    box_height_mm: float = quantity(80.0, 0.0, 400.0)
    cells: int = quantity(4000, 100, 100_000)


@dataclass(frozen=True)
class Workspaces:
    """Workspaces of both benches.

    Attributes:
        free: workspaces up to the singularities, by bench and way.
        guarded: workspaces with the least sine of the transmission angle, by bench and way.
        coarse: workspaces as `free`, with half as many cells.
        common: guarded places that are possible at all angles of the range, by bench.
        offset_deg: largest whole offset alpha with which A_3 keeps away from A_2 [deg].
    """

    free: dict[tuple[str, str], Workspace]
    guarded: dict[tuple[str, str], Workspace]
    coarse: dict[tuple[str, str], Workspace]
    common: dict[str, Workspace]
    offset_deg: int

    @property
    def largest_change(self) -> float:
        """Largest relative difference of an area to that of half the cells."""
        return max(abs(1.0 - self.coarse[key].area / area.area) for key, area in self.free.items())


class BenchWorkspace(Experiment[BenchWorkspaceScenario, Workspaces]):
    """Tells workspaces, the boxes in them, and what speeds and loads ask of the sliders there."""

    schema = BenchWorkspaceScenario
    backends = ("exact",)
    takes = "1 s"

    def run(self, scenario: BenchWorkspaceScenario, runner: Runner) -> Workspaces:
        """Tells all workspaces."""
        free, guarded, coarse, common = {}, {}, {}, {}
        least, cells = scenario.least_sin_mu, scenario.cells
        for name, (geometry, most) in BENCHES.items():
            for way, sign in WAYS.items():
                angle = sign * most
                free[name, way] = workspace(geometry, angle, cells=cells)
                guarded[name, way] = workspace(geometry, angle, least, cells)
                coarse[name, way] = workspace(geometry, angle, cells=cells // 2)
            common[name] = workspace(geometry, _range(most), least, cells)
        return Workspaces(free, guarded, coarse, common, _largest_offset())

    def measure(self, scenario: BenchWorkspaceScenario, data: Workspaces) -> Iterator[Metric]:
        """Areas and extents, boxes, the offset, and what Table 1 asks of the sliders."""
        for name, (_, most) in BENCHES.items():
            yield from _areas(name, math.degrees(most), data)
        yield Metric(
            "area_change",
            data.largest_change,
            bound=_CONVERGED,
            meaning="largest change of an area with half as many cells",
        )
        wide = min(area.width for area in data.free.values())
        tall = min(area.extent.height for area in data.free.values())
        specification = SPECIFICATION
        yield Metric(
            "least_width_mm", 1e3 * wide, "mm", at_least=1e3 * specification.x_range,
            paper=1e3 * specification.x_range,
            meaning="smallest width of the workspace in all orientations",
        )  # fmt: skip
        yield Metric(
            "least_height_mm", 1e3 * tall, "mm", paper=1e3 * specification.z_range,
            meaning="smallest height of the workspace in all orientations",
        )  # fmt: skip
        boxes = [area.widest_box(specification.z_range) for area in data.free.values()]
        fitting = sum(box is not None and box.width >= specification.x_range for box in boxes)
        yield Metric(
            "orientations_with_box", fitting, bound=0,
            meaning="number of orientations of Fig. 6 that contain both ranges of Table 1",
        )  # fmt: skip
        for name in BENCHES:
            yield from _boxes(name, scenario, data)
        yield Metric(
            "alpha_deg", data.offset_deg, "deg", bound=OFFSET_DEG["pedal"],
            at_least=OFFSET_DEG["pedal"], paper=OFFSET_DEG["pedal"],
            meaning="largest whole offset with which A_3 keeps 100 mm from A_2, front end up",
        )  # fmt: skip

    def note(self, scenario: BenchWorkspaceScenario, data: Workspaces) -> Iterator[str]:
        """Part of Table 1 that Table 2 has, and the places where it has it."""
        down = data.free["pedal", "down"].extent
        yield (
            f"Each orientation has {1e3 * SPECIFICATION.x_range:.0f} mm along the rail somewhere, "
            f"and most have {1e3 * SPECIFICATION.z_range:.0f} mm upwards; none has both at once. "
            f"The pedal's front end is down by {math.degrees(SPECIFICATION.pedal_angle):.0f} deg "
            f"only above {1e3 * down.z_min:.1f} mm, where P, T and A_3 are in line."
        )
        for name in BENCHES:
            box = data.common[name].widest_box(1e-3 * scenario.box_height_mm)
            if box is not None:
                yield (
                    f"With sin mu >= {scenario.least_sin_mu:g} the {name} takes all its angles in "
                    f"x = {1e3 * box.x_min:.0f}..{1e3 * box.x_max:.0f} mm, "
                    f"z = {1e3 * box.z_min:.0f}..{1e3 * box.z_max:.0f} mm."
                )

    def details(self, scenario: BenchWorkspaceScenario, data: Workspaces) -> dict[str, Any]:
        """Extents of every workspace, and the boxes."""
        return {
            "extents_m": {
                f"{name} {way}": list(area.extent) for (name, way), area in data.free.items()
            },
            "boxes_m": {
                name: _corners(area.widest_box(1e-3 * scenario.box_height_mm))
                for name, area in data.common.items()
            },
        }

    def draw(self, scenario: BenchWorkspaceScenario, data: Workspaces) -> Iterator[Figure]:
        """The workspaces of Fig. 6, and the boxes that hold for all angles."""
        yield Figure(
            "bench_workspace",
            "Workspaces",
            "Places of the plate's middle, by its orientation (Fig. 6). Light: up to the "
            f"singularities; full: sin mu >= {scenario.least_sin_mu:g}. Dashed: the ranges of "
            "Table 1, which fit nowhere.",
            partial(_draw_workspaces, data),
            (7.0, 5.4),
        )
        yield Figure(
            "bench_boxes",
            "Height and width that hold for all angles",
            "Widest box of a height in which the plate takes every angle of its range, with the "
            "least sine of the transmission angle and without.",
            partial(_draw_boxes, scenario),
            (7.0, 2.8),
        )


def _range(most: float) -> Array:
    return np.linspace(-most, most, _ANGLES)


def _areas(name: str, most_deg: float, data: Workspaces) -> Iterator[Metric]:
    for way, sign in WAYS.items():
        free, guarded = data.free[name, way], data.guarded[name, way]
        angle = f"phi = {sign * most_deg:+.0f} deg" if sign else "plate level"
        meaning = f"area of the {name}'s workspace, {angle}"
        yield Metric(f"{name}_{way}_area_m2", free.area, "m^2", meaning=meaning)
        yield Metric(
            f"{name}_{way}_guarded_m2",
            guarded.area,
            "m^2",
            meaning=f"{meaning}, off singularities",
        )


def _boxes(name: str, scenario: BenchWorkspaceScenario, data: Workspaces) -> Iterator[Metric]:
    """The widest box of the scenario's height, and what Table 1 asks of the sliders in it."""
    height = 1e-3 * scenario.box_height_mm
    box = data.common[name].widest_box(height)
    key = "largest_box_mm" if name == "pedal" else f"{name}_box_mm"
    yield Metric(
        key, 1e3 * (box.width if box else 0.0), "mm",
        meaning=f"widest box, {scenario.box_height_mm:g} mm high, at all angles of the {name}",
    )  # fmt: skip
    if box is None:
        return
    speeds, forces = _asked(*BENCHES[name], box)
    yield Metric(
        f"{name}_vertical_m_s", speeds[1], "m/s",
        meaning=f"largest speed of the {name}'s sliders in that box at "
        f"{SPECIFICATION.speed[1]:g} m/s upwards",
    )  # fmt: skip
    yield Metric(
        f"{name}_turning_m_s", speeds[2], "m/s",
        meaning=f"largest speed of the {name}'s sliders in that box at "
        f"{math.degrees(SPECIFICATION.speed[2]):.0f} deg/s",
    )  # fmt: skip
    yield Metric(
        f"{name}_force_N", forces, "N",
        meaning=f"largest force of the {name}'s sliders under Table 1's loads, plate's middle",
    )  # fmt: skip


def _asked(geometry: BenchGeometry, most: float, box: Box) -> tuple[Array, float]:
    """Largest slider speeds (3), for each of Table 1's speeds alone [m/s], and force [N]."""
    axes = np.linspace(*box[:2], 2), np.linspace(*box[2:], _POINTS), _range(most)
    pose = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    speeds = [
        float(np.abs(slider_rates(geometry, pose, one)).max())
        for one in np.diag(SPECIFICATION.speed)
    ]
    J = np.abs(jacobian(geometry, pose))
    forces = J[:, 0] * SPECIFICATION.load[0] + J[:, 1] * SPECIFICATION.load[1]
    return np.array(speeds), float(forces.max())


def _largest_offset() -> int:
    """Largest whole offset [deg] of the pedal with which A_2 and A_3 keep apart, front end up."""
    pedal, most = BENCHES["pedal"]
    largest = 0
    for degrees in range(1, 60):
        bench = replace(pedal, offset=math.radians(degrees))
        shifted = workspace(replace(bench, strut_gap=None), -most, cells=_ALONG)
        pose = np.stack((0.0 * shifted.z, shifted.z, np.full_like(shifted.z, -most)), axis=-1)
        if shifted.is_empty or margins(bench, pose)[:, _GAP].min() < 0.0:
            return largest
        largest = degrees
    return largest


def _corners(box: Box | None) -> list[float] | None:
    return None if box is None else list(box)


def _draw_workspaces(data: Workspaces, canvas: "Canvas") -> None:
    panels: Any = canvas.subplots(len(WAYS), 2, sharex="col", sharey=True)
    wide, tall = 1e3 * SPECIFICATION.x_range, 1e3 * SPECIFICATION.z_range
    for column, (name, (_, most)), colour in zip(panels.T, BENCHES.items(), COLOURS, strict=False):
        for axes, (way, sign) in zip(column, WAYS.items(), strict=True):
            for area, alpha in ((data.free[name, way], 0.3), (data.guarded[name, way], 0.8)):
                z, ends = 1e3 * area.z, 1e3 * area.ends
                axes.fill_betweenx(z, ends[:, 0], ends[:, 1], color=colour, alpha=alpha, lw=0)
            box = data.free[name, way].extent
            x, z_low = 500.0 * (box.x_min + box.x_max), 1e3 * box.z_min
            x_box = x + 0.5 * wide * np.array((-1, 1, 1, -1, -1))
            axes.plot(x_box, z_low + tall * np.array((0, 0, 1, 1, 0)), "k--", linewidth=0.8)
            axes.set_title(f"{name}, {math.degrees(sign * most):+.0f} deg" if sign else name)
            axes.set(aspect="equal")
        column[-1].set_xlabel("x [mm]")
    for axes in panels[:, 0]:
        axes.set_ylabel("z [mm]")


def _draw_boxes(scenario: BenchWorkspaceScenario, canvas: "Canvas") -> None:
    axes: Any = canvas.subplots()
    heights = np.linspace(0.0, 0.2, 60)
    for (name, (geometry, most)), colour in zip(BENCHES.items(), COLOURS, strict=False):
        for least, style in ((scenario.least_sin_mu, "-"), (0.0, ":")):
            common = workspace(geometry, _range(most), least, 1000)
            boxes = [common.widest_box(height) for height in heights]
            widths = [np.nan if box is None else 1e3 * box.width for box in boxes]
            label = f"{name}, sin mu >= {least:g}"
            axes.plot(1e3 * heights, widths, style, color=colour, label=label)
    ranges = 1e3 * SPECIFICATION.z_range, 1e3 * SPECIFICATION.x_range
    axes.plot(*ranges, "ks", markersize=4, label="Table 1")
    axes.set(xlabel="height of the box [mm]", ylabel="its width [mm]", ylim=(0.0, None))
    axes.legend()
