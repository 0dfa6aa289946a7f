"""Measure the workspace of the platform with its arm, beside the paper's eight surfaces.

Section 4 and Fig. 12 of the paper, exact. Nothing is simulated: every point is a closed form.
`--html` and `--meshcat` show the workspace above the machine as a picture that can be turned.

* The tip is t = R (P_2 + q), Eq. (13), from the support point of leg 2. |t| depends on the
  extension of leg 2 alone, the direction of t gives roll and pitch, these give the other legs.
  Membership is exact and names the leg that limits.
* Four extensions with one condition make a curved octahedron. Each of its eight faces has one leg
  at one end of its stroke; its patches are in closed form too. Volume .01557 m^3, extents 629 x
  829 x 177 mm.
* Share inside the printed surfaces (paper: more than 97 %): 97.5 % by volume, 97.4 % by points
  uniform in the extensions, with the arm's base at (0, 20, 145) mm from F (`geometry.ARM_BASE`).
  That base is an assumption, because Eq. (13) is lost: the round value beside the best base of a
  search, (2, 19, 145) mm. 10 mm further forward the share is 96.1 %, in the middle of the platform
  94.3 %. A grid that counts the ends of the stroke as full points gives 2 to 6 % less.
* Of the volume inside the surfaces, .0160 m^3, 5.4 % is out of reach. Rounding explains that: each
  coefficient changed by up to .005 moves the share between 90 and 98 %.
* Inclined ground: Eq. (14), the workspace rotated with the ground, is not exact. Yaw is zero
  against gravity, so each point turns about the ground's normal through foot 2 by its own angle.
  At 3 and 5 deg that is up to .34 deg and 7 mm, and .014 % of the volume drops out. Ground that
  only rolls is exact for postures that only roll, or only pitch.
* Turntable: its axis goes through the arm's base, so an upright arm gains nothing. Leaning by 45
  deg the arm reaches .0092 m^3 alone and a ring of .409 m^3 with it; the centre of mass stays 481
  mm within the feet.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from scipy.optimize import minimize  # type: ignore[import-untyped]

from parapod.diagrams.designs import is_published
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.sims.lab.experiment import Experiment
from parapod.sims.lab.panel import Panel, Row
from parapod.sims.lab.runner import Runner
from parapod.sims.output.figures import Figure
from parapod.sims.output.options import RunOptions
from parapod.sims.output.results import Metric
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.geometry import ARM_BASE, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import forward_kinematics
from parapod.systems.levelling_platform.statics import KinematicPlatformParams
from parapod.systems.levelling_platform.turntable import stability_margin, swept_volume
from parapod.systems.levelling_platform.workspace import (
    COEFFICIENTS,
    ArmGeometry,
    PostureGrid,
    Workspace,
    boundary,
    enclosed_points,
    inside_surfaces,
    margins_of_terms,
    posture_grid,
    surface_terms,
    tips_and_volumes,
)

# The paper's model, with point feet, and its share of points inside its surfaces.
_PAPER, _PAPER_SHARE = PlatformGeometry(), 0.97
_ROUND_TRIPS = 10_000
_ROUND_TRIP_BOUND = 1e-12  # [m]
# Largest difference of a volume to that at half the resolution.
_RESOLUTION_BOUND = 0.1
# Resolution of what is worked out many times over.
_COARSE = 32
# Half a unit of the printed coefficients' last decimal, and how often they are drawn.
_ROUNDING = 0.005
_ROUNDINGS = 200
# Points along the edge of a face for extents, and turns of the turntable for the stability.
_EDGE = 25
_TURNS = 36


@dataclass
class SlopeScenario(Schema):
    """The ground on which Eq. (14) is checked; everything else is on level ground.

    Attributes:
        roll_deg: roll of the ground [deg].
        pitch_deg: pitch of the ground [deg].
    """

    roll_deg: float = quantity(3.0, -30.0, 30.0)
    pitch_deg: float = quantity(5.0, -30.0, 30.0)

    @property
    def inclination(self) -> tuple[float, float]:
        """Roll and pitch [rad]."""
        return math.radians(self.roll_deg), math.radians(self.pitch_deg)


@dataclass
class ReachScenario(Schema):
    """The arm whose tip is followed.

    Attributes:
        offset_mm: base of the arm from the platform's centre F [mm]; null: `machine.arm.base_mm`,
            which is assumed, because Eq. (13) is lost.
        length_mm: length of the arm [mm]; null: the machine's.
        lean_deg: angle from upright while the turntable turns; otherwise the arm is upright [deg].
    """

    offset_mm: list[float] | None = quantity(None, -20_000.0, 20_000.0, length=3)
    length_mm: float | None = quantity(None, 0.1, 20_000.0)
    lean_deg: float = quantity(45.0, 20.0, 80.0)

    @property
    def lean(self) -> float:
        """Angle of the leaning arm from upright [rad]."""
        return math.radians(self.lean_deg)


@dataclass
class WorkspaceScenario(Schema):
    """Questions about the workspace of the arm's tip.

    It is computed exactly, beside the eight surfaces that the paper prints for it: section 4 and
    Fig. 12. Frame {B} has its origin at the support point of leg 2, the right back one; z is up.

    Attributes:
        backend: method: "exact", closed forms.
        seed: seed of the points of the round trip and of the roundings that are tried.
        resolution: number of cells in each of three dimensions of a volume.
        ground: see `SlopeScenario`.
        arm: see `ReachScenario`.
        turntable: turning of the arm by the motor in its base.
        rollers: true if the feet are rollers of their radius, false if they are points as in the
            paper's model; null: points where the machine is the paper's.
        machine: see `PlatformDesign`.
    """

    backend: str = choice("exact", ("exact",))
    seed: int = quantity(0, 0, 2**31 - 1)
    resolution: int = quantity(64, 16, 128)
    ground: SlopeScenario = field(default_factory=SlopeScenario)
    arm: ReachScenario = field(default_factory=ReachScenario)
    turntable: bool = False
    rollers: bool | None = None
    machine: PlatformDesign = field(default_factory=PlatformDesign)

    @property
    def geometry(self) -> PlatformGeometry:
        """The platform, on points or on rollers."""
        has_rollers = self.rollers
        if has_rollers is None:
            has_rollers = not is_published(self.machine)
        geometry = self.machine.geometry
        return geometry if has_rollers else geometry.on_points()

    @property
    def upright(self) -> ArmGeometry:
        """The arm as in section 4."""
        machine, own = self.machine.reach, self.arm
        offset = machine.offset
        if own.offset_mm is not None:
            x, y, z = (1e-3 * value for value in own.offset_mm)
            offset = (x, y, z)
        length = machine.length if own.length_mm is None else 1e-3 * own.length_mm
        return ArmGeometry(offset, length)

    @property
    def masses(self) -> KinematicPlatformParams:
        """Masses of the machine with that arm."""
        base = [1e3 * length for length in self.upright.offset]
        arm = replace(self.machine.arm, base_mm=base)
        return replace(self.machine, arm=arm).masses

    @property
    def has_surfaces(self) -> bool:
        """Whether it is the machine whose workspace the paper prints surfaces for."""
        return is_published(self.machine)

    @property
    def turned(self) -> float | None:
        """Lean of the arm that the turntable turns [rad]; None: it does not turn."""
        return self.arm.lean if self.turntable else None


class MeasureWorkspace(Experiment[WorkspaceScenario, list["Survey"]]):
    """Measures the workspace."""

    schema = WorkspaceScenario
    backends = ("exact",)
    switches: ClassVar = {
        "turntable": ("turntable=true", "let the motor in the arm's base turn it")
    }
    takes = "10 s"

    def scene(self, scenario: WorkspaceScenario) -> Meshcat:
        """The workspace above the machine, a picture that can be turned."""
        from parapod.sims.levelling_platform.solid import draw

        return draw(scenario.machine, scenario.geometry, scenario.upright, scenario.turned)

    def run(self, scenario: WorkspaceScenario, runner: Runner) -> list["Survey"]:
        """Works out volume, surfaces, inclined ground and, if it may turn, the turntable."""
        steps = {
            "measuring the volume": measure_volume,
            "comparing the printed surfaces": compare_surfaces,
            "inclining the ground": check_inclined_ground,
        }
        if not scenario.has_surfaces:
            del steps["comparing the printed surfaces"]
        if scenario.turntable:
            steps["turning the turntable"] = measure_turntable
        with runner.console.status("") as status:
            surveys = []
            for what, step in steps.items():
                status.update(what)
                surveys.append(step(scenario))
        return surveys

    def measure(self, scenario: WorkspaceScenario, data: list["Survey"]) -> Iterator[Metric]:
        """Numbers of all surveys."""
        for survey in data:
            yield from survey.metrics

    def note(self, scenario: WorkspaceScenario, data: list["Survey"]) -> Iterator[str]:
        """Sentences of all surveys."""
        for survey in data:
            yield from survey.notes

    def draw(self, scenario: WorkspaceScenario, data: list["Survey"]) -> Iterable[Figure]:
        """The solid, its sections and the turntable's ring (Fig. 12)."""
        from parapod.sims.levelling_platform.solid import figures

        geometry, arm = scenario.geometry, scenario.upright
        return figures(geometry, arm, scenario.turned, scenario.has_surfaces)

    def afterwards(
        self, scenario: WorkspaceScenario, data: list["Survey"], options: RunOptions
    ) -> Callable[[], None] | None:
        """Draws the workspace for the browser; what is left to do is to wait for its viewers."""
        if not options.meshcat:
            return None
        from parapod.sims.levelling_platform.solid import present

        values_by_key = {metric.key: metric.value for metric in self.measure(scenario, data)}
        rows = [
            Row(
                f"extent along {axis}",
                true=values_by_key[f"extent_{axis}_mm"],
                unit="mm",
                decimals=0,
            )
            for axis in "xyz"
        ]
        panel = Panel(self.scene(scenario), f"{self.name}: the reach of the arm's tip")
        return present(panel, "the workspace", rows, options)


@dataclass(frozen=True)
class Survey:
    """Numbers and notes on one matter.

    Attributes:
        metrics: the numbers.
        notes: sentences that explain them.
    """

    metrics: tuple[Metric, ...]
    notes: tuple[str, ...] = ()


def measure_volume(scenario: WorkspaceScenario) -> Survey:
    """Volume and extents of the workspace, and the closed form's round trip."""
    geometry, arm = scenario.geometry, scenario.upright
    volume = _volume(geometry, arm, scenario.resolution)
    coarser = _volume(geometry, arm, scenario.resolution // 2)
    tips = Workspace(geometry, arm).tip_of_extensions(boundary(geometry, _EDGE))
    extents = [
        Metric(
            f"extent_{axis}_mm",
            1e3 * float(np.ptp(tips[:, i])),
            "mm",
            meaning=f"extent of the workspace along {axis}",
        )
        for i, axis in enumerate("xyz")
    ]
    return Survey(
        (
            Metric(
                "volume_m3", volume, "m^3", meaning="volume of all points that the tip reaches"
            ),
            _resolution_error("volume", volume, coarser),
            *extents,
            Metric(
                "round_trip_error_m",
                _round_trip_error(scenario, arm),
                "m",
                _ROUND_TRIP_BOUND,
                meaning=f"largest error of {_ROUND_TRIPS} round trips from extensions to tip, on "
                "a slope",
            ),
        )
    )


def _volume(geometry: PlatformGeometry, arm: ArmGeometry, resolution: int) -> float:
    return float(tips_and_volumes(geometry, arm, posture_grid(geometry, resolution))[1].sum())


def _resolution_error(what: str, value: float, coarser: float) -> Metric:
    return Metric(
        f"{what.split()[0]}_resolution_error",
        abs(coarser / value - 1.0),
        "",
        _RESOLUTION_BOUND,
        meaning=f"relative change of the {what} from half the resolution",
    )


def _round_trip_error(scenario: WorkspaceScenario, arm: ArmGeometry) -> float:
    geometry = scenario.geometry
    low, high = geometry.extension_min, geometry.extension_max
    random = np.random.default_rng(scenario.seed)
    extension = random.uniform(low, high, (_ROUND_TRIPS, 3))
    workspace = Workspace(geometry, arm, scenario.ground.inclination)
    _, reached = workspace.extensions_reaching(workspace.tip_of_extensions(extension))
    return float(np.abs(reached[:, :3] - extension).max())


def compare_surfaces(scenario: WorkspaceScenario) -> Survey:
    """Compare the eight printed surfaces with the workspace, and say why they differ."""
    arm = scenario.upright
    grid = posture_grid(_PAPER, scenario.resolution)
    volume, is_inside = _inside(arm, grid)
    enclosed, cell = enclosed_points(scenario.resolution)
    is_reached = Workspace(_PAPER, arm).reaches(enclosed)
    best = best_offset(arm)
    share = _share(*_inside(replace(arm, offset=best), grid))
    metrics = (
        Metric(
            "inside_fraction",
            _share(volume, is_inside),
            at_least=_PAPER_SHARE,
            paper=_PAPER_SHARE,
            meaning="share of the workspace's volume inside the eight printed surfaces",
        ),
        Metric(
            "inside_fraction_counted",
            _share(grid.count, is_inside),
            paper=_PAPER_SHARE,
            meaning="share inside the surfaces of points uniform in three legs' extensions",
        ),
        Metric(
            "inside_fraction_best",
            share,
            paper=_PAPER_SHARE,
            meaning="largest share of the volume inside the surfaces for any base of the arm",
        ),
        Metric(
            "unreachable_fraction",
            1.0 - float(is_reached.mean()),
            paper=0.0,
            meaning="share of the enclosed volume that the tip does not reach",
        ),
        Metric(
            "enclosed_volume_m3",
            cell * len(enclosed),
            "m^3",
            meaning="volume that the surfaces enclose",
        ),
    )
    return Survey(metrics, (_about_base(arm, best, share), _about_rounding(scenario, best)))


def _inside(arm: ArmGeometry, grid: PostureGrid) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The volume that each posture stands for, and whether its tip is inside all surfaces."""
    tips, volume = tips_and_volumes(_PAPER, arm, grid)
    return volume, inside_surfaces(tips).all(axis=-1)


def _share(weight: NDArray[np.float64], which: NDArray[np.bool_]) -> float:
    return float(weight[which].sum() / weight.sum())


@cache
def best_offset(arm: ArmGeometry) -> tuple[float, float, float]:
    """Base of the arm for which the largest share of the volume is inside the surfaces [m]."""
    grid = posture_grid(_PAPER, _COARSE)
    # The tips and their derivatives are affine in the offset: four of it give those of all.
    corners = [replace(arm, offset=(x, y, z)) for x, y, z in np.vstack([np.zeros(3), np.eye(3)])]
    spaces = [Workspace(_PAPER, corner) for corner in corners]
    tips = np.stack([space.tip_position(grid.posture) for space in spaces])
    slopes = np.stack([space.tip_jacobian(grid.posture) for space in spaces])

    def outside(offset: NDArray[np.float64]) -> float:
        shares = np.append(1.0 - offset.sum(), offset)
        volume = np.abs(np.linalg.det(np.tensordot(shares, slopes, 1)))
        inside = inside_surfaces(np.tensordot(shares, tips, 1)).all(axis=-1)
        return 1.0 - _share(grid.cell * volume, inside)

    start = np.array(ARM_BASE)
    simplex = start + np.vstack([np.zeros(3), 0.01 * np.eye(3)])
    optimum = minimize(
        outside,
        start,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 2e-4, "fatol": 1e-5},
    )
    x, y, z = optimum.x.tolist()
    return x, y, z


def _about_base(arm: ArmGeometry, best: tuple[float, float, float], share: float) -> str:
    def words(offset: tuple[float, float, float]) -> str:
        return "(" + ", ".join(f"{1e3 * value:.0f}" for value in offset) + ") mm"

    return (
        f"The share hangs on where the arm's base stands, which is lost with Eq. (13): "
        f"{words(arm.offset)} is assumed; the largest share, {100.0 * share:.1f} %, is that of "
        f"{words(best)}."
    )


def _about_rounding(scenario: WorkspaceScenario, best: tuple[float, float, float]) -> str:
    arm = replace(scenario.upright, offset=best)
    tips, volume = tips_and_volumes(_PAPER, arm, posture_grid(_PAPER, _COARSE))
    terms = surface_terms(tips)
    random = np.random.default_rng(scenario.seed)
    is_rounded = COEFFICIENTS != 0.0
    is_rounded[:, 0] = False
    shares = []
    for _ in range(_ROUNDINGS):
        error = _ROUNDING * is_rounded * random.uniform(-1.0, 1.0, COEFFICIENTS.shape)
        is_inside = (margins_of_terms(terms, COEFFICIENTS + error) > 0.0).all(axis=-1)
        shares.append(_share(volume, is_inside))
    low, high = 100.0 * np.percentile(shares, (5.0, 95.0))
    return (
        f"With the base there, changing the printed coefficients by up to half a unit of their "
        f"second decimal gives {low:.0f} to {high:.0f} % (5th to 95th percentile): two decimals "
        f"do not define the surfaces better."
    )


def check_inclined_ground(scenario: WorkspaceScenario) -> Survey:
    """Eq. (14): is the workspace on inclined ground that of level ground, rotated?"""
    geometry, arm = scenario.geometry, scenario.upright
    grid = posture_grid(geometry, scenario.resolution // 2)
    level, volume = tips_and_volumes(geometry, arm, grid)
    on_slope = Workspace(geometry, arm, scenario.ground.inclination)
    inclined = on_slope.tip_of_extensions(grid.extension)
    turn = np.arctan2(inclined[:, 1], inclined[:, 0]) - np.arctan2(level[:, 1], level[:, 0])
    apart = np.linalg.norm(inclined - level, axis=-1)
    is_lost = ~on_slope.reaches(level)
    metrics = (
        Metric(
            "inclined_difference_mm",
            1e3 * float(apart.max()),
            "mm",
            paper=0.0,
            meaning="largest distance of the tip on inclined ground from Eq. (14)",
        ),
        Metric(
            "inclined_difference_fraction",
            _share(volume, is_lost),
            paper=0.0,
            meaning="share of Eq. (14)'s workspace that the tip does not reach on that ground",
        ),
    )
    note = (
        "Eq. (14) is not exact: legs, roll and pitch of the platform against the ground are the "
        "same on any ground, but yaw is zero against gravity, so that each point is turned about "
        f"the ground's normal through foot 2, by up to {math.degrees(np.abs(turn).max()):.2f} deg "
        "here."
    )
    return Survey(metrics, (note,))


def measure_turntable(scenario: WorkspaceScenario) -> Survey:
    """Measure the reach of a leaning arm without and with the turntable, and its stability."""
    geometry = scenario.geometry
    arm = replace(scenario.upright, lean=scenario.arm.lean)
    leaning = _volume(geometry, arm, scenario.resolution)
    swept = swept_volume(geometry, arm, scenario.resolution)
    coarser = swept_volume(geometry, arm, scenario.resolution // 2)
    metrics = (
        Metric(
            "leaning_volume_m3", leaning, "m^3", meaning="volume reached by the leaning arm alone"
        ),
        Metric(
            "swept_volume_m3", swept, "m^3", meaning="volume reached with the turntable turning it"
        ),
        _resolution_error("swept volume", swept, coarser),
        Metric(
            "swept_gain",
            swept / leaning,
            meaning="ratio of the volume with the turntable to that of the leaning arm",
        ),
        Metric(
            "stability_margin_mm",
            1e3 * _least_stability(geometry, scenario.masses, scenario.arm.lean),
            "mm",
            at_least=0.0,
            meaning="smallest distance of the centre of mass from the edges between the feet",
        ),
    )
    note = (
        "The turntable's axis goes through the arm's base: it moves the tip of a leaning arm "
        f"only. Swept volume: {scenario.resolution} by {scenario.resolution} cells in each of "
        f"{scenario.resolution // 2} directions from that axis."
    )
    return Survey(metrics, (note,))


def _least_stability(
    geometry: PlatformGeometry, masses: KinematicPlatformParams, lean: float
) -> float:
    """Smallest `stability_margin` at the boundary of the workspace, level ground, all turns."""
    extension = boundary(geometry, _EDGE)
    attitude = forward_kinematics(geometry, extension, (0.0, 0.0))[:, :2]
    margins = []
    for turn in (2.0 * math.pi * np.arange(_TURNS) / _TURNS).tolist():
        centre = masses.centre_with(masses.arm.leaning(lean, turn))
        margins.append(stability_margin(geometry, extension, attitude, centre).min())
    return float(min(margins))
