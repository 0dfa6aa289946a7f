"""Lead a foot of the walking chair round a circle, in three modes of its drives' control.

Figs. 10, 11 and 14 of the paper. The three drives of leg 1 are led from node to node as the
paper's controllers do it: by positions at full speed, by velocities, and by velocities that
correct what is missing from the position (Eqs. 46-48). The foot's true place, which encoders
cannot tell, is compared with Eq. (49).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

from parapod.diagrams.plots import Limits
from parapod.diagrams.style import COLOURS
from parapod.diagrams.walking_chair.design import ChairDesign
from parapod.diagrams.walking_chair.leg_loop import LegLoopParams, make_leg_loop
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.walking_chair.view import LegTwin
from parapod.sims.lab.experiment import Experiment, Logged
from parapod.sims.lab.runner import Runner
from parapod.sims.output.drawn import LogDrawing
from parapod.sims.output.figures import Figure, draw_bound
from parapod.sims.output.results import Metric
from parapod.systems.actuators.compound_position_controller import (
    MODES,
    CompoundPositionControllerParams,
)
from parapod.systems.actuators.velocity_servo import VelocityServoParams
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.walking_chair.checks import check_speeds, check_strokes, stroke_excess
from parapod.systems.walking_chair.geometry import LegGeometry, branch_names
from parapod.systems.walking_chair.leg import leg_forward
from parapod.systems.walking_chair.rates import leg_jacobian, leg_motion
from parapod.systems.walking_chair.trajectories import BranchMotion, FootCircle

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

type Floats = NDArray[np.float64]
# The paper's experiment is with leg 1, whose number the errors name.
_LEGS = (1,)
# Time after which the start has no effect [s].
SETTLING = 1.0
_CHECKED = 1e-3  # between times at which strokes and speeds are checked [s]
# Result of the laser tracker, "comparing the radius" of the trajectories [mm].
PAPER_RADIAL_MM = 2.454
# Error of the compound mode by the time between two nodes [mm/s]: it is a lag, which goes with
# that time.
_ERROR_BY_PERIOD = 60.0
_COMPOUND_BY_VELOCITY = 0.2
_COMPOUND_BY_POSITION = 0.1
_GROWTH_MM = 0.05
_PLACES = 3601
# Magnification of errors of the radius against the circle.
_MAGNIFIED = 20.0
_MODE_COLOURS = {"compound": COLOURS[0], "velocity": COLOURS[1], "position": COLOURS[2]}
_PLANNED = "black"
# Length of the drawn ripple [s], and its branch, the one that moves fastest.
_WINDOW = 0.4
_FASTEST = 1
_PANEL = 9  # font size of a panel's title


@dataclass
class CircleScenario(Schema):
    """The circle of the foot's corner E1, Eq. (49).

    Attributes:
        radius_mm: radius of the circle [mm].
        centre_y_mm: centre of the circle, ahead of the leg's UP hinge [mm].
        z_mm: plane of the circle, above that hinge [mm].
        lap_duration: duration of one lap at full speed [s].
        laps: number of laps; the second one shows whether errors accumulate.
        ramp: duration of the sines that lead up to full speed and down from it [s]; 0 for the
            paper's steps.
    """

    radius_mm: float = quantity(100.0, 1.0, 300.0)
    centre_y_mm: float = quantity(100.0, -300.0, 300.0)
    z_mm: float = quantity(-675.4, -1000.0, -600.0)
    lap_duration: float = quantity(5.0, 2.0, 120.0)
    laps: int = quantity(3, 1, 100)
    ramp: float = quantity(0.0, 0.0, 60.0)

    @property
    def circle(self) -> FootCircle:
        """Circle in SI units.

        Raises:
            ScenarioError: the ramps leave no time at full speed.
        """
        longest = self.laps * self.lap_duration
        if self.ramp > longest:
            raise ScenarioError(
                f"circle.ramp = {self.ramp:g} s is longer than all laps, {longest:g} s",
                "circle.ramp",
            )
        return FootCircle(
            radius=1e-3 * self.radius_mm,
            centre_y=1e-3 * self.centre_y_mm,
            z=1e-3 * self.z_mm,
            period=self.lap_duration,
            laps=self.laps,
            ramp=self.ramp,
        )


@dataclass
class CircleControlScenario(Schema):
    """The position controllers; all gains are assumptions.

    Attributes:
        period: time between two nodes [s].
        proportional: P of Eq. (47) [1/s].
        k_p: proportional gain of the velocity PI, Eq. (48) [-].
        k_i: integral gain of the velocity PI per sample, Eq. (48) [-].
    """

    period: float = quantity(0.01, 0.001, 0.1)
    proportional: float = quantity(10.0, 0.0, 100.0)
    k_p: float = quantity(0.6, 0.0, 10.0)
    k_i: float = quantity(0.25, 0.0, 10.0)


@dataclass
class CircleDriveScenario(Schema):
    """The three drives; all values but the largest velocity are assumptions.

    Attributes:
        time_constant_ms: time constant of a drive's velocity loop [ms].
        max_velocity_mm_s: largest command that a drive follows, as in the paper [mm/s].
        encoder_resolution_mm: one count of the encoders [mm]; 0 for perfect ones.
        gain: velocity of each drive by its command [-].
        offset_mm_s: velocity of each drive at a command of zero [mm/s].
        gain_error: largest deviation of each gain from `gain`, drawn from the seed [-].
        offset_error_mm_s: largest deviation of each offset from `offset_mm_s`, drawn from the seed
            [mm/s].
    """

    time_constant_ms: float = quantity(40.0, 1.0, 500.0)
    max_velocity_mm_s: float = quantity(80.0, 1.0, 1000.0)
    encoder_resolution_mm: float = quantity(0.005, 0.0, 1.0)
    gain: list[float] = quantity([1.02, 0.985, 1.01], 0.5, 1.5, length=3)
    offset_mm_s: list[float] = quantity([-1.0, -1.0, -1.0], -20.0, 20.0, length=3)
    gain_error: float = quantity(0.0, 0.0, 0.5)
    offset_error_mm_s: float = quantity(0.0, 0.0, 20.0)


@dataclass
class ChairCircleScenario(Schema):
    """One foot on its circle, in every mode of its drives' control.

    Leg 1 leads its foot round the circle in each of the control modes that the paper compares:
    section "Experiment research of PLM 1", Figs. 10, 11 and 14. The paper prints no gains and
    nothing of the drives.

    Attributes:
        backend: plant: "kinematic", the leg in closed form and its drives as lags.
        seed: seed of the drives' errors, where any are drawn.
        machine: see `ChairDesign`; its drives are those below.
        circle: see `CircleScenario`.
        rest: time for which the foot is watched after the circle [s].
        control: see `CircleControlScenario`.
        drives: see `CircleDriveScenario`.
    """

    backend: str = choice("kinematic", ("kinematic",))
    seed: int = quantity(0, 0, 2**31 - 1)
    machine: ChairDesign = field(default_factory=ChairDesign)
    circle: CircleScenario = field(default_factory=CircleScenario)
    rest: float = quantity(0.5, 0.0, 60.0)
    control: CircleControlScenario = field(default_factory=CircleControlScenario)
    drives: CircleDriveScenario = field(default_factory=CircleDriveScenario)

    def loop(self, mode: str) -> LegLoopParams:
        """The leg with its drives controlled in a mode.

        Raises:
            ScenarioError: see `CircleScenario.circle`.
        """
        control, drives = self.control, self.drives
        # One count: a perfect encoder still needs a band in which a drive stands still.
        count = 1e-3 * max(drives.encoder_resolution_mm, 1e-3)
        gain, offset = self._imperfections()
        return LegLoopParams(
            circle=self.circle.circle,
            controller=CompoundPositionControllerParams(
                mode=mode,
                proportional=control.proportional,
                k_p=control.k_p,
                k_i=control.k_i,
                velocity_limit=1e-3 * drives.max_velocity_mm_s,
                dead_band=count,
            ),
            period=control.period,
            drive=VelocityServoParams(
                resolution=1e-3 * drives.encoder_resolution_mm,
                time_constant=1e-3 * drives.time_constant_ms,
                max_velocity=1e-3 * drives.max_velocity_mm_s,
            ),
            gain=gain,
            offset=offset,
            geometry=self.machine.geometry.leg,
        )

    def _imperfections(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Gains [-] and offsets [m/s] of the three drives, the same for every mode."""
        random = np.random.default_rng(self.seed)
        drives = self.drives
        gains = drives.gain + random.uniform(-1.0, 1.0, 3) * drives.gain_error
        offsets = drives.offset_mm_s + random.uniform(-1.0, 1.0, 3) * drives.offset_error_mm_s
        a, b, c = gains.tolist()
        d, e, f = (1e-3 * offsets).tolist()
        return (a, b, c), (d, e, f)


@dataclass(frozen=True)
class Recording:
    """A foot on its circle.

    Attributes:
        geometry: the leg.
        circle: path that it should follow.
        time: (n) [s].
        position: (n, 3) where the drives really are [m].
        velocity: (n, 3) velocities of the branches [m/s].
        foot: (n, 3) where the corner E1 really is, in {A1} [m].
    """

    geometry: LegGeometry
    circle: FootCircle
    time: Floats
    position: Floats
    velocity: Floats
    foot: Floats

    @property
    def error(self) -> Floats:
        """(n, 3) of the foot, from where it should be at the same instant [m]."""
        return self.foot - self.circle.motion(self.time).position

    @property
    def distance(self) -> Floats:
        """(n) between the foot and where it should be at the same instant [m]."""
        return np.linalg.norm(self.error, axis=-1)

    @property
    def radial_error(self) -> Floats:
        """(n) distance from the circle's axis less the radius: the trajectory without time [m]."""
        return np.hypot(self.foot[:, 0], self.foot[:, 1] - self.circle.centre_y) - (
            self.circle.radius
        )

    @property
    def moves(self) -> NDArray[np.bool_]:
        """(n) times of the circle."""
        return self.time <= self.circle.duration

    @property
    def is_settled(self) -> NDArray[np.bool_]:
        """(n) times of the circle without its first second."""
        return self.moves & (self.time >= SETTLING)

    @property
    def foot_error_mm(self) -> float:
        """Largest error of the foot on the circle, the first second left out [mm]."""
        return 1e3 * float(self.distance[self.is_settled].max())

    @property
    def radial_error_mm(self) -> float:
        """Largest error of the trajectory's radius on the circle, either way [mm]."""
        return 1e3 * float(np.abs(self.radial_error[self.moves]).max())

    @property
    def ripple_mm_s(self) -> float:
        """Root mean square of the velocities about the planned ones [mm/s]."""
        about: Floats = self.velocity - self.planned.velocity
        return 1e3 * float(np.sqrt(np.mean(about[self.is_settled] ** 2)))

    @cached_property
    def planned(self) -> BranchMotion:
        """Planned motion of the branches, arrays (n, 3)."""
        return leg_motion(self.geometry, self.circle.motion(self.time))


class ChairCircle(Experiment[ChairCircleScenario, dict[str, Recording]]):
    """Follows the circle in every mode."""

    schema = ChairCircleScenario
    drawing = LogDrawing(
        CHAIR,
        {"leg.position": "compound.position", "leg.position_desired": "position_desired"},
        LegTwin,
        plots=(
            "foot_desired[0:2]+compound.foot[0:2]",
            "compound.position",
            "velocity_desired+compound.velocity",
            "position.velocity",
        ),
    )
    backends = ("kinematic",)
    takes = "10 s"

    def check(self, scenario: ChairCircleScenario) -> None:
        """Refuses a circle that takes a branch out of its stroke, or is too fast for it."""
        circle = scenario.circle.circle
        time = np.linspace(0.0, circle.duration, round(circle.duration / _CHECKED) + 1)
        geometry = scenario.machine.geometry.leg
        motion = leg_motion(geometry, circle.motion(time))
        check_strokes(geometry, motion.length[:, np.newaxis], time, _LEGS)
        limit = 1e-3 * scenario.drives.max_velocity_mm_s
        check_speeds(motion.velocity[:, np.newaxis], limit, time, _LEGS)

    def loop(self, scenario: ChairCircleScenario, **options: Any) -> Diagram:
        """The leg in the first mode."""
        return make_leg_loop(scenario.loop(MODES[0])).diagram

    def run(self, scenario: ChairCircleScenario, runner: Runner) -> dict[str, Recording]:
        """Runs every control mode; by the mode's name."""
        return {mode: _record(scenario, mode, runner) for mode in MODES}

    def logged(self, scenario: ChairCircleScenario, data: dict[str, Recording]) -> Logged:
        """Plan and drives in all modes, which have the same times."""
        any_one = data[MODES[0]]
        signals: dict[str, tuple[Floats, str]] = {
            "position_desired": (any_one.planned.length, "m"),
            "velocity_desired": (any_one.planned.velocity, "m/s"),
            "foot_desired": (any_one.circle.motion(any_one.time).position, "m"),
        }
        for mode, recording in data.items():
            signals[f"{mode}.position"] = (recording.position, "m")
            signals[f"{mode}.velocity"] = (recording.velocity, "m/s")
            signals[f"{mode}.foot"] = (recording.foot, "m")
        return any_one.time, signals

    def machine_scenario(self, scenario: ChairCircleScenario) -> ChairScenario:
        """The chair of which it is a leg."""
        return ChairScenario(machine=scenario.machine)

    def limits(self, scenario: ChairCircleScenario) -> Limits:
        """Strokes of the leg's branches, and speeds that the drives are asked for."""
        low, high = scenario.machine.geometry.leg.strokes.T
        speed = 1e-3 * scenario.drives.max_velocity_mm_s
        return {
            **{f"{mode}.position": (low, high) for mode in MODES},
            **{f"{mode}.velocity": (-speed, speed) for mode in MODES},
            "position_desired": (low, high),
            "velocity_desired": (-speed, speed),
        }

    def measure(
        self, scenario: ChairCircleScenario, data: dict[str, Recording]
    ) -> Iterator[Metric]:
        """Errors of foot and velocities, and how errors of lengths move the foot."""
        yield from _errors(scenario, data)
        yield from _velocities(scenario, data)
        yield from _effects(scenario.circle.circle)

    def note(self, scenario: ChairCircleScenario, data: dict[str, Recording]) -> Iterable[str]:
        """Causes of the errors."""
        compound = data["compound"]
        any_way, radially = sensitivities(compound.circle)
        return (
            f"The {PAPER_RADIAL_MM:g} mm by which the paper's radius is off are not the "
            f"control's: that leaves {compound.radial_error_mm:.2f} mm here. They are what "
            f"lengths can do that are off by {PAPER_RADIAL_MM / radially:.2f} mm (root of the sum "
            "of squares over the three branches): play in the joints, homing, the leg's "
            "dimensions. The paper puts them down to the mechanism too. For each mm of such an "
            f"error the foot moves by up to {any_way:.2f} mm.",
            "The mode velocity keeps what it loses at the start: its sum of velocity errors is a "
            "position, without which it would drift. The mode position runs to every node at full "
            "speed and stops there.",
            "Without circle.ramp the foot is asked to move at full speed at once, and to stop at "
            "once; that is where the largest errors are.",
        )

    def draw(self, scenario: ChairCircleScenario, data: dict[str, Recording]) -> Iterable[Figure]:
        """Branches, circle and errors (Figs. 10, 11 and 14)."""
        return (
            Figure(
                "fig11_circle_branches",
                "Branches of the leg on the circle",
                "Lengths and velocities of the three branches for a lap of Eq. (49) (Fig. 11).",
                partial(_draw_branches, data["compound"]),
                (9.0, 3.2),
            ),
            Figure(
                "fig14_circle",
                "The foot's trajectory in three control modes",
                f"From above: the circle of Eq. (49), and the foot's trajectory with errors of "
                f"the radius {_MAGNIFIED:g} times as large (Fig. 14). All laps. That the mode "
                "velocity is late does not show here.",
                partial(_draw_circle, data),
                (9.6, 3.7),
            ),
            Figure(
                "circle_errors",
                "Error of the foot over time",
                "Above the error of the foot at each instant, dashed its bound in mode compound; "
                "below the error of the trajectory's radius, which a foot that is late has not.",
                partial(_draw_errors, data, _compound_bound(scenario)),
                (8.0, 4.6),
            ),
            Figure(
                "circle_ripple",
                "Velocity of a branch in three control modes",
                f"{branch_names((1,))[_FASTEST].capitalize()} at its fastest: what is planned, "
                "and what the drive does.",
                partial(_draw_ripple, data),
                (9.0, 3.0),
            ),
        )


def _record(scenario: ChairCircleScenario, mode: str, runner: Runner) -> Recording:
    params = scenario.loop(mode)
    loop = make_leg_loop(params)
    simulator = Simulator(loop.diagram)
    simulator.Initialize()
    until = params.circle.duration + scenario.rest
    runner.simulate(simulator, until, f"mode {mode}")
    time, position, velocity = loop.recorded(simulator.get_context())
    foot = leg_forward(params.geometry, position).point
    return Recording(params.geometry, params.circle, time, position, velocity, foot)


def _compound_bound(scenario: ChairCircleScenario) -> float:
    """Bound of the foot's error in mode compound [mm]."""
    return _ERROR_BY_PERIOD * scenario.control.period


def _errors(scenario: ChairCircleScenario, recordings: dict[str, Recording]) -> Iterator[Metric]:
    """Errors of the foot in every mode, and how they compare."""
    errors = {mode: recording.foot_error_mm for mode, recording in recordings.items()}
    bounds = {"compound": _compound_bound(scenario)}
    for mode, error in errors.items():
        meaning = f"largest error of the foot from {SETTLING:g} s on, mode {mode}"
        yield Metric(f"foot_error_{mode}_mm", error, "mm", bounds.get(mode), meaning=meaning)
    yield Metric(
        "compound_by_velocity",
        errors["compound"] / errors["velocity"],
        "",
        _COMPOUND_BY_VELOCITY,
        meaning="ratio of the foot's error in mode compound to that in mode velocity",
    )
    for mode, recording in recordings.items():
        yield Metric(
            f"largest_error_{mode}_mm",
            1e3 * float(recording.distance.max()),
            "mm",
            paper="at both ends" if mode == "compound" else None,
            meaning=f"largest error of the whole run with its steps of the speed, mode {mode}",
        )
    for mode, recording in recordings.items():
        yield Metric(
            f"radial_error_{mode}_mm",
            recording.radial_error_mm,
            "mm",
            paper=PAPER_RADIAL_MM if mode == "compound" else None,
            meaning=f"largest error of the trajectory's radius on the circle, mode {mode}",
        )
    if scenario.circle.laps > 1:
        yield Metric(
            "growth_compound_mm",
            _growth_mm(recordings["compound"], scenario.circle.lap_duration),
            "mm",
            _GROWTH_MM,
            paper=0.0,
            meaning="largest error of the last lap less that of the first, mode compound",
        )


def _velocities(
    scenario: ChairCircleScenario, recordings: dict[str, Recording]
) -> Iterator[Metric]:
    """Motion of the branches."""
    ripples = {mode: recording.ripple_mm_s for mode, recording in recordings.items()}
    for mode, ripple in ripples.items():
        yield Metric(
            f"ripple_{mode}_mm_s",
            ripple,
            "mm/s",
            paper="little noticeable" if mode == "compound" else None,
            meaning=f"ripple of the branches' velocities, root mean square, mode {mode}",
        )
    yield Metric(
        "ripple_by_position",
        ripples["compound"] / ripples["position"],
        "",
        _COMPOUND_BY_POSITION,
        meaning="ratio of the ripple in mode compound to that in mode position",
    )
    compound, limit = recordings["compound"], scenario.drives.max_velocity_mm_s
    for key, velocity, meaning in (
        (
            "planned",
            compound.planned.velocity,
            "largest speed of a branch on the circle, as planned",
        ),
        ("max", compound.velocity, "largest speed of a branch, mode compound"),
    ):
        largest = 1e3 * float(np.abs(velocity).max())
        yield Metric(f"{key}_branch_speed_mm_s", largest, "mm/s", limit, meaning=meaning)
    yield Metric(
        "stroke_left_mm",
        -1e3 * float(stroke_excess(compound.geometry, compound.planned.length).max()),
        "mm",
        at_least=0.0,
        meaning="smallest planned distance of a branch from the ends of its stroke",
    )


def _effects(circle: FootCircle) -> Iterator[Metric]:
    """Effects of wrong lengths of the branches on the foot."""
    any_way, radially = sensitivities(circle)
    yield Metric(
        "foot_error_by_branch_error",
        any_way,
        meaning="largest error of the foot on the circle by that of the lengths (root of squares)",
    )
    yield Metric(
        "radial_error_by_branch_error",
        radially,
        meaning="largest error of the radius by that of the lengths (root of squares)",
    )
    yield Metric(
        "branch_error_for_paper_mm",
        PAPER_RADIAL_MM / radially,
        "mm",
        meaning="error of the lengths (root of squares) that explains the paper's radial error",
    )


def sensitivities(
    circle: FootCircle, geometry: LegGeometry = LegGeometry()
) -> tuple[float, float]:
    """Largest error of the foot, and of its radius, by a unit of error of the lengths.

    The first is the largest singular value of J^-1, which is in the direction that suits it; the
    second the largest norm of the row of J^-1 along the radius.
    """
    time = np.linspace(0.0, circle.duration, _PLACES)
    places = circle.motion(time).position
    foot_by_lengths = np.linalg.inv(leg_jacobian(geometry, places))
    outwards = (places - (0.0, circle.centre_y, circle.z)) / circle.radius
    rows = np.einsum("...i,...ij->...j", outwards, foot_by_lengths)
    any_way = np.linalg.norm(foot_by_lengths, ord=2, axis=(-2, -1)).max()
    return float(any_way), float(np.linalg.norm(rows, axis=-1).max())


def _growth_mm(recording: Recording, lap: float) -> float:
    time, distance = recording.time, recording.distance
    first = recording.is_settled & (time <= SETTLING + lap)
    last = recording.moves & (time >= recording.circle.duration - lap)
    return 1e3 * float(distance[last].max() - distance[first].max())


def _draw_branches(recording: Recording, canvas: "Canvas") -> None:
    lap = recording.time <= recording.circle.period + recording.circle.ramp
    time, planned = recording.time[lap], recording.planned
    panels: Any = canvas.subplots(1, 2)
    for axes, values, label in zip(
        panels,
        (planned.length, planned.velocity),
        ("length [mm]", "velocity [mm/s]"),
        strict=True,
    ):
        for i, name in enumerate(branch_names((1,))):
            axes.plot(time, 1e3 * values[lap, i], label=name)
        axes.set_xlabel("time [s]")
        axes.set_ylabel(label)
    canvas.legend(
        *panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8
    )


def _draw_circle(recordings: dict[str, Recording], canvas: "Canvas") -> None:
    panels: Any = canvas.subplots(1, len(recordings), sharex=True, sharey=True)
    for axes, (mode, recording) in zip(panels, recordings.items(), strict=True):
        circle = recording.circle
        planned = circle.motion(recording.time).position[:, :2]
        outwards = recording.foot[:, :2] - (0.0, circle.centre_y)
        outwards /= np.linalg.norm(outwards, axis=-1, keepdims=True)
        radius = circle.radius + _MAGNIFIED * recording.radial_error[:, np.newaxis]
        ideal = (0.0, circle.centre_y) + radius * outwards
        axes.plot(*1e3 * planned.T, color=_PLANNED, linewidth=0.9, label="Eq. (49)")
        foot = f"foot, its error\n{_MAGNIFIED:g} times as large"
        axes.plot(*1e3 * ideal.T, color=_MODE_COLOURS[mode], linewidth=0.9, label=foot)
        axes.legend(loc="center", fontsize=8)
        axes.set_aspect("equal")
        axes.set_title(f"mode {mode}", fontsize=_PANEL)
        axes.set_xlabel("x [mm]")
    panels[0].set_ylabel("y [mm]")


def _draw_errors(recordings: dict[str, Recording], bound: float, canvas: "Canvas") -> None:
    upper, lower = canvas.subplots(2, 1, sharex=True)
    for i, (mode, recording) in enumerate(recordings.items()):
        # The first on top: the last one runs to and fro.
        style: dict[str, Any] = {"color": _MODE_COLOURS[mode], "linewidth": 0.9, "zorder": 9 - i}
        upper.plot(recording.time, 1e3 * recording.distance, label=f"mode {mode}", **style)
        lower.plot(recording.time, 1e3 * recording.radial_error, **style)
    upper.set_ylabel("error [mm]")
    draw_bound(upper, bound, "bound of mode compound")
    lower.set_ylabel("radial error [mm]")
    lower.set_xlabel("time [s]")
    for axes in (upper, lower):
        axes.axvline(SETTLING, color="0.6", linewidth=0.8, linestyle="dotted")
    canvas.legend(
        *upper.get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8
    )


def _draw_ripple(recordings: dict[str, Recording], canvas: "Canvas") -> None:
    panels: Any = canvas.subplots(1, len(recordings), sharex=True, sharey=True)
    for axes, (mode, recording) in zip(panels, recordings.items(), strict=True):
        planned = np.where(recording.is_settled, recording.planned.velocity[:, _FASTEST], 0.0)
        middle = recording.time[np.argmax(np.abs(planned))]
        in_window = np.abs(recording.time - middle) <= 0.5 * _WINDOW
        time = recording.time[in_window]
        velocity = recording.velocity[in_window, _FASTEST]
        axes.plot(time, 1e3 * velocity, color=_MODE_COLOURS[mode], label="drive")
        axes.plot(time, 1e3 * planned[in_window], color=_PLANNED, linewidth=0.9, label="planned")
        axes.set_title(f"mode {mode}", fontsize=_PANEL)
        axes.set_xlabel("time [s]")
    panels[0].set_ylabel("velocity [mm/s]")
    canvas.legend(
        *panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, fontsize=8
    )
