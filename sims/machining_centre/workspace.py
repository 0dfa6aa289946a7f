"""Measure where the machining centres reach and what they resist there, beside Tables I and II.

Section VI of the paper, exact: nothing is simulated, no direction of a wrench is sampled. The
paper's percentages are those of a coarse grid; here cells are as small as is asked for, and the
same grid stands beside them.

The first row of Table I comes out with 20 nodes an edge, faces included (16.35 and 16.05 %,
printed 16.31 and 16.04 %); converged it is 18.6 and 18.5 %. The other rows and Table II do not
come out under any reading that was tried.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from parapod.diagrams.style import COLOURS
from parapod.sims.lab.experiment import Experiment
from parapod.sims.lab.runner import Runner
from parapod.sims.output.figures import Figure
from parapod.sims.output.progress import counted
from parapod.sims.output.results import Metric
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.printed import (
    CUBE,
    CUBE_HEIGHT,
    MEANS,
    MEANS_ABOVE,
    REACHABLE_PERCENT,
    THRESHOLDS,
)
from parapod.systems.machining_centre.workspace import (
    Survey,
    cell_centres,
    is_reachable,
    nodes,
    survey,
)
from parapod.systems.machining_centre.wrench import wrench_indices

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

NAMES = {3: "tripod", 4: "quadruped"}
# Nodes of the grid along each edge with which Table I's first row comes out.
_NODES = 20
_NODES_ERROR = 0.05  # [points of a percentage]
# Percentages with cells twice as large differ by less [points].
_CONVERGED = 0.3
# Heights of Fig. 12's sections, which the paper does not print [m], and points along their edges.
_HEIGHTS = (0.4, 0.475, 0.55)
_SECTION = 101
_SECTION_EDGE = 0.8  # [m]


@dataclass
class CentreWorkspaceScenario(Schema):
    """The box that Section VI-D of the paper tests, platform upright.

    Attributes:
        backend: method: "exact", closed forms.
        seed: seed, which changes nothing: nothing is random.
        cell_mm: edge of the cells into which the box is divided [mm].
        height_mm: height of the box's middle above the feet [mm]. The paper says that the box is
            500 mm above them: so its middle must be, its bottom cannot.
    """

    backend: str = choice("exact", ("exact",))
    seed: int = quantity(0, 0, 2**31 - 1)
    cell_mm: float = quantity(12.5, 4.0, 100.0)
    height_mm: float = quantity(1e3 * CUBE_HEIGHT, 250.0, 1000.0)


@dataclass(frozen=True)
class Workspaces:
    """Surveys of both centres, by the number of limbs.

    Attributes:
        fine: in cells.
        coarse: in cells with twice the edge.
        printed: at the nodes of a grid as coarse as the paper's.
    """

    fine: dict[int, Survey]
    coarse: dict[int, Survey]
    printed: dict[int, Survey]

    @cached_property
    def largest_change(self) -> float:
        """Largest difference of a percentage between the two cells [points]."""
        changes = [
            self.fine[limbs].percent(threshold) - self.coarse[limbs].percent(threshold)
            for limbs in NAMES
            for threshold in THRESHOLDS
        ]
        return float(np.abs(changes).max())


class CentreWorkspace(Experiment[CentreWorkspaceScenario, Workspaces]):
    """Counts points and averages indices."""

    schema = CentreWorkspaceScenario
    backends = ("exact",)
    takes = "5 s"

    def run(self, scenario: CentreWorkspaceScenario, runner: Runner) -> Workspaces:
        """Tests all points of both centres."""
        height, cell = 1e-3 * scenario.height_mm, 1e-3 * scenario.cell_mm
        grids = {
            "fine": cell_centres(CUBE, height, cell),
            "coarse": cell_centres(CUBE, height, 2.0 * cell),
            "printed": nodes(CUBE, height, _NODES),
        }
        total = len(NAMES) * sum(map(len, grids.values()))
        surveys: dict[str, dict[int, Survey]] = {}
        with counted(runner.console, "points", total) as tell:
            points_done = 0
            for name, points in grids.items():
                surveys[name] = {}
                for limbs in NAMES:
                    before = points_done

                    def report(count: int, before: int = before) -> None:
                        tell(before + count)

                    surveys[name][limbs] = survey(CentreGeometry(limbs), points, report)
                    points_done += len(points)
        return Workspaces(**surveys)

    def measure(self, scenario: CentreWorkspaceScenario, data: Workspaces) -> Iterator[Metric]:
        """Both tables, how well they converge, and the bounds of w_max."""
        for limbs, name in NAMES.items():
            yield from _table(name, data.fine[limbs], limbs)
        yield Metric(
            "largest_change",
            data.largest_change,
            "points",
            _CONVERGED * (scenario.cell_mm / 12.5),
            meaning="largest change of a percentage with cells twice as large",
        )
        if scenario.height_mm == 1e3 * CUBE_HEIGHT:
            yield from _comparison(data)

    def note(self, scenario: CentreWorkspaceScenario, data: Workspaces) -> Iterator[str]:
        """Reasons why two printed means cannot be."""
        three, four = data.fine[3], data.fine[4]
        if not len(three.reachable) or not len(four.reachable):
            yield "No point of the box can be reached."
            return
        yield (
            f"Table II prints a mean w_Max of {MEANS[4][1]} for the quadruped. All legs pushing "
            f"at once exert at least {four.push.min():.3f} wherever it reaches, whatever weighs "
            "the moments: a mean below that cannot be."
        )
        yield (
            f"For the tripod it prints {MEANS[3][1]}. With moments about P_O by r_c = r_p the "
            f"largest w_Max anywhere is {three.indices.w_max.max():.3f}: a mean above that cannot "
            "be."
        )

    def details(self, scenario: CentreWorkspaceScenario, data: Workspaces) -> dict[str, Any]:
        """Both tables as the paper has them, printed and here."""
        return {
            "table_1": {
                NAMES[limbs]: {
                    "threshold": list(THRESHOLDS),
                    "printed_percent": list(REACHABLE_PERCENT[limbs]),
                    "here_percent": [data.fine[limbs].percent(t) for t in THRESHOLDS],
                    "nodes_percent": [data.printed[limbs].percent(t) for t in THRESHOLDS],
                }
                for limbs in NAMES
            }
        }

    def draw(self, scenario: CentreWorkspaceScenario, data: Workspaces) -> Iterator[Figure]:
        """Table I as curves, and the sections of Fig. 12."""
        yield Figure(
            "centre_reach",
            "Reachable points",
            "Share of the box where w_MinMax exceeds a threshold, here and in Table I; the feet "
            "stand as in Fig. 11.",
            partial(_draw_reach, data),
        )
        yield Figure(
            "centre_ratio",
            "Isotropy at three heights",
            "Ratio eta_w = w_Max / w_MinMax, platform upright (Fig. 12); white: out of reach.",
            _draw_sections,
            (7.0, 4.9),
        )


def _table(name: str, survey: Survey, limbs: int) -> Iterator[Metric]:
    for threshold, printed in zip(THRESHOLDS, REACHABLE_PERCENT[limbs], strict=True):
        key = "reachable" if not threshold else f"above_{round(1e3 * threshold):03d}"
        condition = f" with w_MinMax > {threshold:g}" if threshold else ""
        yield Metric(
            f"{name}_{key}_percent",
            survey.percent(threshold),
            "%",
            paper=printed,
            meaning=f"share of the box that the {name} reaches{condition}",
        )
    names = {"w_minmax": "w_MinMax", "w_max": "w_Max", "ratio": "w_Max / w_MinMax"}
    means = survey.means(MEANS_ABOVE) if survey.percent(MEANS_ABOVE) else (math.nan,) * 3
    for (key, words), mean, printed in zip(names.items(), means, MEANS[limbs], strict=True):
        if math.isfinite(mean):
            meaning = f"mean of {words} where w_MinMax > {MEANS_ABOVE:g}, {name}"
            yield Metric(f"{name}_{key}_mean", mean, paper=printed, meaning=meaning)


def _comparison(data: Workspaces) -> Iterator[Metric]:
    """The paper's grid, the order of the two machines, and what cannot be."""
    counted = {limbs: data.printed[limbs].percent(0.0) for limbs in NAMES}
    printed = {limbs: REACHABLE_PERCENT[limbs][0] for limbs in NAMES}
    for limbs, name in NAMES.items():
        meaning = f"share of nodes that the {name} reaches, {_NODES} along an edge, faces included"
        yield Metric(
            f"{name}_nodes_percent", counted[limbs], "%", paper=printed[limbs], meaning=meaning
        )
    yield Metric(
        "nodes_error",
        max(abs(counted[limbs] - printed[limbs]) for limbs in NAMES),
        "points",
        _NODES_ERROR,
        meaning="largest error of Table I's first row with these nodes",
    )
    three, four = data.fine[3], data.fine[4]
    yield Metric(
        "tripod_reaches_more",
        three.percent(0.0) - four.percent(0.0),
        "points",
        at_least=0.0,
        meaning="share of the box reached by the tripod, less the quadruped's",
    )
    yield Metric(
        "quadruped_resists_more",
        min(four.percent(t) - three.percent(t) for t in THRESHOLDS[1:]),
        "points",
        at_least=0.0,
        meaning="smallest lead of the quadruped in the share of the box above each threshold",
    )
    yield Metric(
        "quadruped_w_max_least",
        float(four.push.min()),
        at_least=MEANS[4][1],
        meaning="smallest w_Max of the quadruped, however moments are weighed; the printed "
        "mean is less",
    )
    yield Metric(
        "tripod_w_max_most",
        float(three.indices.w_max.max()),
        bound=MEANS[3][1],
        meaning="largest w_Max of the tripod; the printed mean is more",
    )


def _draw_reach(data: Workspaces, canvas: "Canvas") -> None:
    axes: Any = canvas.subplots()
    for colour, (limbs, name) in zip(COLOURS, NAMES.items(), strict=False):
        survey = data.fine[limbs]
        values = np.append(np.sort(survey.indices.w_minmax)[::-1], 0.0)
        percent = (
            100.0 * np.minimum(np.arange(1, len(values) + 1), len(values) - 1) / survey.points
        )
        axes.plot(values, percent, color=colour, label=f"{name}, here")
        printed = REACHABLE_PERCENT[limbs]
        axes.plot(THRESHOLDS, printed, "o--", color=colour, linewidth=0.8, label="Table I")
    axes.set(xlabel="threshold of w_MinMax [-]", ylabel="share of the box [%]")
    axes.set(xlim=(-0.003, 0.14), ylim=(0.0, None))
    axes.legend()


def _draw_sections(canvas: "Canvas") -> None:
    panels: Any = canvas.subplots(2, len(_HEIGHTS), sharex=True, sharey=True)
    axis = np.linspace(-0.5, 0.5, _SECTION) * _SECTION_EDGE
    image: Any = None
    for row, limbs in zip(panels, NAMES, strict=True):
        for axes, height in zip(row, _HEIGHTS, strict=True):
            ratio = _section(CentreGeometry(limbs), axis, height)
            image = axes.pcolormesh(
                1e3 * axis, 1e3 * axis, ratio.T, vmin=7.0, vmax=14.0, rasterized=True
            )
            axes.set(aspect="equal")
            axes.grid(False)
    for axes, height in zip(panels[0], _HEIGHTS, strict=True):
        axes.set_title(f"z = {1e3 * height:g} mm")
    for axes in panels[-1]:
        axes.set_xlabel("x [mm]")
    for axes, name in zip(panels[:, 0], NAMES.values(), strict=True):
        axes.set_ylabel(f"{name}, y [mm]")
    canvas.colorbar(image, ax=panels, label="eta_w [-]", shrink=0.8)


def _section(geometry: CentreGeometry, axis: Array, height: float) -> Array:
    """Ratio (k, k) at points of a horizontal section; NaN outside the stroke."""
    x, y = np.meshgrid(axis, axis, indexing="ij")
    points = np.stack((x, y, np.full_like(x, height)), axis=-1).reshape(-1, 3)
    ratio = np.full(len(points), np.nan)
    poses = np.hstack((points, np.zeros_like(points)))
    inside = is_reachable(geometry, poses)
    ratio[inside] = wrench_indices(geometry, poses[inside]).ratio
    return ratio.reshape(x.shape)
