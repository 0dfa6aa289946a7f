"""Measure how long the tip of a flexible arm swings after a move, as it is and with shapers.

The platform levels itself and holds; then the arm swings, once with the command as it is and once
with each input shaper: zero vibration (ZV), zero vibration and derivative (ZVD), extra insensitive
(EI). They wait for half a period of the vibration or for a whole one, and leave the tip at rest.

The second figure is about a rod that is not the one that the shapers were designed for: simulated
on a base at rest (dots), beside the residual that theory gives (lines).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from parapod.diagrams.levelling_platform.machine import swing_to
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.shaping import arm_shaper
from parapod.sims.lab.run import Run, realtime_metric
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.levelling import LevellingExperiment
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.input_shaper import Shaper, ShaperKind
from parapod.systems.arm.rod_motion import ClampMotion, RodMotion
from parapod.systems.core.errors import ScenarioError

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

KINDS: tuple[str, ...] = ("none", *get_args(ShaperKind.__value__))
_NAMES = {"none": "unshaped", "zv": "ZV", "zvd": "ZVD", "ei": "EI"}
# Largest residual of a shaped command by the unshaped one [%].
_BOUND = 5.0
# Periods of the vibration in which its amplitude is measured, and that must follow the swing [-].
_PERIODS, _AFTER = 1.5, 4.0
# Frequencies of other rods by that of the known one, and step of their simulation [-, s].
_SCALES, _STEP = np.linspace(0.7, 1.3, 13), 5e-3


@dataclass(frozen=True)
class Runs:
    """Runs with each command.

    Attributes:
        by_kind: runs by the kind of their shaper; "none" is the unshaped one.
        run: the run that is watched.
    """

    by_kind: dict[str, Run]

    @property
    def run(self) -> Run:
        """The last run, which is watched."""
        return list(self.by_kind.values())[-1]


class ArmVibration(LevellingExperiment[Runs]):
    """Swings the arm with each kind of command; the run of `control.arm_shaper` is watched."""

    signals = ("truth.tip_deflection", "truth.tip_pose", "arm.position_command")
    takes = "20 s"

    def check(self, scenario: LevellingScenario) -> None:
        """Refuses an arm that does not bend, and a job that ends too early.

        Raises:
            ScenarioError: names the key.
        """
        super().check(scenario)
        if scenario.machine.arm.bending is None:
            raise ScenarioError("machine.arm must bend: it must be !FlexibleRod", "machine.arm")
        if scenario.control.arm_shaper == "none":
            key, kinds = "control.arm_shaper", ", ".join(KINDS[1:])
            raise ScenarioError(f"{key} must be one of {kinds}: its run is watched", key)
        least = max(_arrival(_shaped(scenario, kind)) for kind in KINDS)
        least += _PERIODS * _period(scenario) - scenario.job.estimate_at
        if scenario.job.end < least:
            least = 0.1 * math.ceil(10.0 * least)
            raise ScenarioError(
                f"job.end = {scenario.job.end:g} s is too early: the vibration after the swing "
                f"is measured until {least:g} s",
                "job.end",
            )

    def run(self, scenario: LevellingScenario, runner: Runner) -> Runs:
        """Swings the arm with each kind of command; that of the scenario comes last."""
        kinds = [kind for kind in KINDS if kind != scenario.control.arm_shaper]
        runs = {
            kind: self.run_loop(_shaped(scenario, kind), runner, watched=False) for kind in kinds
        }
        runs[scenario.control.arm_shaper] = self.run_loop(scenario, runner)
        return Runs(runs)

    def measure(self, scenario: LevellingScenario, data: Runs) -> Iterator[Metric]:
        """Amplitudes after the swing, by that of the unshaped one, and delays."""
        amplitudes = {
            kind: _amplitude(_shaped(scenario, kind), run) for kind, run in data.by_kind.items()
        }
        unshaped = amplitudes["none"]
        yield Metric(
            "unshaped_residual_mm",
            unshaped,
            "mm",
            meaning="largest amplitude of the tip after the swing, command as it is",
        )
        for kind in KINDS[1:]:
            name = _NAMES[kind]
            yield Metric(
                f"{kind}_residual_percent",
                100.0 * amplitudes[kind] / unshaped,
                "%",
                _BOUND,
                meaning=f"ratio of the amplitude with the {name} shaper to that without",
            )
            yield Metric(
                f"{kind}_delay_s",
                _delay(_shaped(scenario, kind)),
                "s",
                meaning=f"time by which the {name} shaper ends the swing later",
            )
        yield realtime_metric(*data.by_kind.values())

    def note(self, scenario: LevellingScenario, data: Runs) -> Iterator[str]:
        """The frequency that the shapers are designed for."""
        shaper_hertz = 1.0 / _period(scenario)
        yield (
            f"the rod swings at {shaper_hertz:.3g} Hz; drives and platform that yield make a "
            "measured one a little lower"
        )

    def draw(self, scenario: LevellingScenario, data: Runs) -> Iterator[Figure]:
        """The tip over time, and the residual of rods that are softer and stiffer."""
        yield _tip_figure(scenario, data)
        yield _robustness_figure(scenario)


def _shaped(scenario: LevellingScenario, kind: str) -> LevellingScenario:
    return replace(scenario, control=replace(scenario.control, arm_shaper=kind))


def _delay(scenario: LevellingScenario) -> float:
    """Time by which the command ends later [s]."""
    shaper = arm_shaper(scenario)
    return 0.0 if shaper is None else shaper.delay + scenario.control.period


def _arrival(scenario: LevellingScenario) -> float:
    """Time at which the swing ends [s]."""
    job = scenario.job
    return job.estimate_at + job.arm.start + job.arm.duration + _delay(scenario)


def _rod(scenario: LevellingScenario) -> FlexibleRod:
    rod = scenario.machine.arm.bending
    assert rod is not None
    return rod


def _period(scenario: LevellingScenario) -> float:
    """Period of the vibration in the plane of the swing [s]."""
    omega = _rod(scenario).loaded_frequencies(scenario.machine.masses.gravity)[0, 0]
    return float(2.0 * math.pi / omega)


def _amplitude(scenario: LevellingScenario, run: Run) -> float:
    """Amplitude of the tip in the plane of the swing, after it [mm]."""
    arrival = _arrival(scenario)
    counts = (run.time >= arrival) & (run.time <= arrival + _PERIODS * _period(scenario))
    return 500.0 * float(np.ptp(run["truth.tip_deflection"][counts, 0]))


def _tip_figure(scenario: LevellingScenario, data: Runs) -> Figure:
    job = scenario.job
    begins = job.estimate_at + job.arm.start

    def draw(canvas: "Canvas") -> None:
        upper, lower = canvas.subplots(2, 1, sharex=True, height_ratios=(1, 2))
        for kind in KINDS:
            run = data.by_kind[kind]
            time = run.time - begins
            look: dict[str, Any] = {"label": _NAMES[kind], "linewidth": 1.6}
            upper.plot(time, np.degrees(run["arm.position_command"][:, -1]), **look)
            lower.plot(time, 1e3 * run["truth.tip_deflection"][:, 0], **look)
        lower.set_xlim(-0.2, float(data.run.time[-1]) - begins)
        upper.set_ylabel("command [deg]")
        lower.set_xlabel("time from the beginning of the swing [s]")
        lower.set_ylabel("tip's deflection [mm]")
        upper.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)

    return Figure(
        "arm_vibration",
        "The arm's swing",
        "Above the commands, below how far the tip is from where a rigid rod would have it.",
        draw,
        (8.0, 4.6),
    )


def _robustness_figure(scenario: LevellingScenario) -> Figure:
    shapers = {kind: arm_shaper(_shaped(scenario, kind)) or Shaper() for kind in KINDS}
    omega, damping = 2.0 * math.pi / _period(scenario), _rod(scenario).damping_ratio

    def draw(canvas: "Canvas") -> None:
        axes = canvas.subplots()
        scales = np.linspace(_SCALES[0], _SCALES[-1], 241)
        for kind in KINDS[1:]:
            (line,) = axes.plot(
                100.0 * (scales - 1.0),
                100.0 * shapers[kind].residual(scales * omega, damping),
                label=_NAMES[kind],
                linewidth=1.6,
            )
            simulated = [simulated_residual(scenario, shapers[kind], scale) for scale in _SCALES]
            dots: dict[str, Any] = {"markersize": 4, "color": line.get_color()}
            axes.plot(100.0 * (_SCALES - 1.0), simulated, "o", **dots)
        axes.axhline(_BOUND, color="0.5", linewidth=0.8, linestyle="--")
        axes.set(
            xlabel="frequency of the rod by the one that is known [%]",
            ylabel="residual vibration [% of the unshaped]",
            xlim=(-30.0, 30.0),
            ylim=(0.0, None),
        )
        axes.legend()

    return Figure(
        "shaper_robustness",
        "Rods that are softer and stiffer than known",
        "Residual vibration after the swing: lines by theory, dots simulated on a base at rest. "
        f"Dashed: {_BOUND:g} %.",
        draw,
        (8.0, 4.6),
    )


def simulated_residual(scenario: LevellingScenario, shaper: Shaper, scale: float) -> float:
    """Amplitude after the swing by the unshaped one, of a rod on a base at rest [%]."""
    rod = _rod(scenario)
    stiffness = rod.bending_stiffness[0] * scale**2, rod.bending_stiffness[1]
    other = replace(rod, bending_stiffness=stiffness, modes=1)
    shaped, unshaped = (_swing(scenario, other, each) for each in (shaper, Shaper()))
    return 100.0 * shaped / unshaped


def _swing(scenario: LevellingScenario, rod: FlexibleRod, shaper: Shaper) -> float:
    """Amplitude of the tip after the swing, of a rod on a base at rest [m]."""
    job, gravity = scenario.job, scenario.machine.masses.gravity
    duration = job.arm.duration
    way = swing_to([math.radians(job.arm.angle_deg)], 0.1, duration, 1e3)
    rate, acceleration = way.derivative(1), way.derivative(2)
    motion = RodMotion(rod, _STEP)
    state, places = motion.rest((0.0, 0.0, gravity)), []
    end = 0.1 + duration + shaper.delay
    omega = float(rod.loaded_frequencies(gravity)[0, 0])
    impulses = list(zip(shaper.times, shaper.amplitudes, strict=True))
    for k in range(int((end + _PERIODS * 2.0 * math.pi / omega) / _STEP)):
        middle = (k + 0.5) * _STEP
        angle, w, a = (
            sum(by * float(part.value(max(0.0, middle - late))[0, 0]) for late, by in impulses)
            for part in (way, rate, acceleration)
        )
        force = -gravity * math.sin(angle), 0.0, gravity * math.cos(angle)
        state = motion.step(state, ClampMotion(force, (0.0, w, 0.0), (0.0, a, 0.0)))
        if middle > end:
            places.append(state[0])
    return 0.5 * float(np.ptp(places) * rod.shape(rod.length)[0])
