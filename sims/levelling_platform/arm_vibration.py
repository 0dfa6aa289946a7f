"""Measure how long the tip of a flexible arm swings after a move, shaped, and damped by the legs.

The platform levels itself and holds; then the arm swings, once with the command as it is and once
with each input shaper: zero vibration (ZV), zero vibration and derivative (ZVD), extra insensitive
(EI). They wait for half a period of the vibration or for a whole one, and leave the tip at rest.

With the legs alone the command stays as it is, and the legs incline the platform so that the tip
comes to rest; no sensor is on the rod. The last run has shaper and legs.

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
from parapod.diagrams.levelling_platform.vibration import arm_shaper, feedforward_system
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

SHAPERS: tuple[str, ...] = get_args(ShaperKind.__value__)
# Runs: the command as it is, with each shaper, with the legs alone, and with shaper and legs.
KINDS: tuple[str, ...] = ("none", *SHAPERS, "legs", "both")
_NAMES = {"none": "unshaped", "zv": "ZV", "zvd": "ZVD", "ei": "EI"}
_NAMES |= {"legs": "legs alone", "both": "shaper and legs"}
# Largest residual by that of the command as it is: of a shaped one, and with the legs alone [%].
_BOUND, _LEGS_BOUND = 5.0, 30.0
# Periods of the vibration in which its amplitude is measured, and that must follow the swing [-].
_PERIODS, _AFTER = 1.5, 4.0
# Frequencies of other rods by that of the known one, and step of their simulation [-, s].
_SCALES, _STEP = np.linspace(0.7, 1.3, 13), 5e-3
_MEANINGS = {"legs": "the legs alone", "both": "shaper and legs"}
# Largest inclination at the end of the job, as that of a levelled platform [deg].
_TILT = 0.2
# Beginning of the figure, from that of the swing [s].
_FIRST = -0.2
# Residual up to which those of other rods are drawn [%].
_DRAWN = 100.0


@dataclass(frozen=True)
class Runs:
    """Runs with each command.

    Attributes:
        by_kind: runs by what leaves the tip at rest; "none" is the command as it is.
        run: the run that is watched.
    """

    by_kind: dict[str, Run]

    @property
    def run(self) -> Run:
        """The last run, which is watched."""
        return list(self.by_kind.values())[-1]


class ArmVibration(LevellingExperiment[Runs]):
    """Swings the arm as it is, shaped, and with the legs against the vibration.

    The run with both `control.arm_shaper` and `control.arm_damping_by_legs` is watched.
    """

    signals = (
        *("truth.tip_deflection", "truth.tip_pose", "truth.posture"),
        "arm.position_command",
    )
    takes = "30 s"

    def check(self, scenario: LevellingScenario) -> None:
        """Refuses an arm that does not bend, and a job that ends too early.

        Raises:
            ScenarioError: names the key.
        """
        super().check(scenario)
        if scenario.machine.arm.bending is None:
            raise ScenarioError("machine.arm must bend: it must be !FlexibleRod", "machine.arm")
        if scenario.control.arm_shaper == "none":
            key, kinds = "control.arm_shaper", ", ".join(SHAPERS)
            raise ScenarioError(f"{key} must be one of {kinds}: its run is watched", key)
        if scenario.control.arm_damping_by_legs == "none":
            key = "control.arm_damping_by_legs"
            raise ScenarioError(f"{key} must not be none: the legs' run is watched", key)
        least = max(_arrival(_variant(scenario, kind)) for kind in KINDS)
        least += _PERIODS * _period(scenario) - scenario.job.estimate_at
        if scenario.job.end < least:
            least = 0.1 * math.ceil(10.0 * least)
            raise ScenarioError(
                f"job.end = {scenario.job.end:g} s is too early: the vibration after the swing "
                f"is measured until {least:g} s",
                "job.end",
            )

    def run(self, scenario: LevellingScenario, runner: Runner) -> Runs:
        """Swings the arm in each way; that of the scenario comes last."""
        runs = {
            kind: self.run_loop(_variant(scenario, kind), runner, watched=False)
            for kind in KINDS[:-1]
        }
        return Runs(runs | {KINDS[-1]: self.run_loop(scenario, runner)})

    def measure(self, scenario: LevellingScenario, data: Runs) -> Iterator[Metric]:
        """Amplitudes after the swing, by that of the command as it is, and delays."""
        amplitudes = {
            kind: _amplitude(_variant(scenario, kind), run) for kind, run in data.by_kind.items()
        }
        unshaped = amplitudes["none"]
        yield Metric(
            "unshaped_residual_mm",
            unshaped,
            "mm",
            meaning="largest amplitude of the tip after the swing, command as it is",
        )
        for kind in KINDS[1:]:
            what = _MEANINGS.get(kind, f"the {_NAMES[kind]} shaper")
            yield Metric(
                f"{kind}_residual_percent",
                100.0 * amplitudes[kind] / unshaped,
                "%",
                _LEGS_BOUND if kind == "legs" else _BOUND,
                meaning=f"ratio of the amplitude with {what} to that without",
            )
            yield Metric(
                f"{kind}_delay_s",
                _delay(_variant(scenario, kind)),
                "s",
                meaning=f"time by which the vibration ends later with {what}",
            )
        yield Metric(
            "tilt_after_deg",
            _tilt_after(scenario, data.run),
            "deg",
            _TILT,
            meaning="largest angle of the platform at the end, with shaper and legs",
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


def _variant(scenario: LevellingScenario, kind: str) -> LevellingScenario:
    """The scenario of a run."""
    if kind == "both":
        return scenario
    control = scenario.control
    if kind == "legs":
        control = replace(control, arm_shaper="none")
    else:
        control = replace(control, arm_shaper=kind, arm_damping_by_legs="none")
    return replace(scenario, control=control)


def _delay(scenario: LevellingScenario) -> float:
    """Time by which the vibration ends later than the swing [s]."""
    control, shaper = scenario.control, arm_shaper(scenario)
    delay = 0.0 if shaper is None else shaper.delay + control.period
    if control.arm_damping_by_legs in ("feedforward", "both"):
        delay += feedforward_system(scenario).delay
    return delay


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


def _tilt_after(scenario: LevellingScenario, run: Run) -> float:
    """Largest inclination of the platform in the last moments of the job [deg]."""
    last = run.time >= run.time[-1] - _PERIODS * _period(scenario)
    tilt: float = np.degrees(np.linalg.norm(run["truth.posture"][last, :2], axis=1)).max()
    return tilt


def _tip_figure(scenario: LevellingScenario, data: Runs) -> Figure:
    job = scenario.job
    begins = job.estimate_at + job.arm.start

    def draw(canvas: "Canvas") -> None:
        upper, middle, lower = canvas.subplots(3, 1, sharex=True, height_ratios=(1, 1, 2.4))
        for kind in KINDS:
            run = data.by_kind[kind]
            run = run.after(begins + _FIRST)
            time = run.time - begins
            look: dict[str, Any] = {"label": _NAMES[kind], "linewidth": 1.6}
            upper.plot(time, np.degrees(run["arm.position_command"][:, -1]), **look)
            middle.plot(time, np.degrees(run["truth.posture"][:, 1]), **look)
            lower.plot(time, 1e3 * run["truth.tip_deflection"][:, 0], **look)
        lower.set_xlim(_FIRST, float(data.run.time[-1]) - begins)
        upper.set_ylabel("arm [deg]")
        middle.set_ylabel("pitch [deg]")
        lower.set_xlabel("time from the beginning of the swing [s]")
        lower.set_ylabel("tip's deflection [mm]")
        upper.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(KINDS))

    return Figure(
        "arm_vibration",
        "The arm's swing",
        "Commands of the arm, what the legs do to the platform's pitch, and how far the tip is "
        "from where a rigid rod would have it.",
        draw,
        (8.0, 5.6),
    )


def _robustness_figure(scenario: LevellingScenario) -> Figure:
    shapers = {kind: arm_shaper(_variant(scenario, kind)) or Shaper() for kind in SHAPERS}
    legs = feedforward_system(scenario)
    omega, damping = 2.0 * math.pi / _period(scenario), _rod(scenario).damping_ratio

    def draw(canvas: "Canvas") -> None:
        axes = canvas.subplots()
        scales = np.linspace(_SCALES[0], _SCALES[-1], 241)
        for kind in SHAPERS:
            (line,) = axes.plot(
                100.0 * (scales - 1.0),
                100.0 * shapers[kind].residual(scales * omega, damping),
                label=_NAMES[kind],
                linewidth=1.6,
            )
            simulated = [simulated_residual(scenario, shapers[kind], scale) for scale in _SCALES]
            dots: dict[str, Any] = {"markersize": 4, "color": line.get_color()}
            axes.plot(100.0 * (_SCALES - 1.0), simulated, "o", **dots)
        axes.plot(
            100.0 * (scales - 1.0),
            [100.0 * legs.residual(scale * omega) for scale in scales],
            label=_NAMES["legs"],
            linewidth=1.6,
        )
        axes.axhline(_BOUND, color="0.5", linewidth=0.8, linestyle="--")
        axes.set(
            xlabel="frequency of the rod by the one that is known [%]",
            ylabel="residual vibration [% of the unshaped]",
            xlim=(-30.0, 30.0),
            ylim=(0.0, _DRAWN),
        )
        axes.legend()

    return Figure(
        "shaper_robustness",
        "Rods that are softer and stiffer than known",
        "Residual vibration after the swing: lines by theory (of the legs their feedforward), "
        "dots simulated on a base at rest. "
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
