"""Follow postures with legs as drawn, as built, and with the outer inclination loop.

Figs. 20 to 22 of the paper, and beyond them. Three machines follow the same postures: one with
legs as drawn, one with manufacturing errors, and the second one again with the outer inclination
loop that the paper leaves as its next step, with delayed inertial measurements. The loop's
stability margins are computed from the linearised diagram.

A real machine has the legs that it has: it follows the postures twice, without and with the outer
loop, and is measured by its own sensors.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.levelling_platform.inclination_margins import alone, margins, open_loop
from parapod.diagrams.levelling_platform.scenario import SIMULATED, LevellingScenario
from parapod.sims.lab.run import Run
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.levelling import (
    AS_MEASURED,
    MEASURED,
    LevellingExperiment,
    error_metrics,
    in_deg_and_mm,
    measured_posture,
    posture_figure,
)
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.core.errors import ScenarioError
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.sensors.imu import sample_period

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

_PAPER = (0.2, 0.2, 2.0)
_OUTER_BOUND = 0.05  # bound of roll and pitch at rest [deg]
# Errors of a real machine's actuators while they follow; some four times the emulated ones [mm].
_EXTENSION_BOUND = 0.5
# Inclination error by an accelerometer bias of 0.25 mg on two axes, which no loop can
# see: a machine that happens to be built better than that has nothing to gain [deg].
_SENSOR = 0.02
# After a posture has been reached the outer loop is given this long to settle [s].
_SETTLING = 4.0
# Margins that are asked for with every gain and delay below: usual values of loop shaping.
_GAIN_MARGIN, _PHASE_MARGIN = 6.0, 45.0  # [dB, deg]
_GAIN_SCALES = (0.85, 1.0, 1.15)
_DELAYS = (0.0, 0.02)  # [s]


@dataclass(frozen=True)
class _Run:
    """A machine's errors.

    Attributes:
        run: recorded signals.
        posture: (n, 3) true one, or on a real machine the measured one [deg, deg, mm].
        desired: (n, 3) [deg, deg, mm].
        at_rest: (n) whether the reference has rested for a while.
        moving: (n) whether the reference moves, once the level posture has been taken.
    """

    run: Run
    posture: NDArray[np.float64]
    desired: NDArray[np.float64]
    at_rest: NDArray[np.bool_]
    moving: NDArray[np.bool_]

    @classmethod
    def from_run(cls, scenario: LevellingScenario, run: Run) -> Self:
        """Looks at a run."""
        state = run["posture_desired_state"]
        changing = (np.abs(state[:, 3:]) > 1e-9).any(axis=1)
        began = scenario.job.estimate_at + scenario.job.settled_after
        last = np.maximum.accumulate(np.where(changing, run.time, began))
        at_rest = run.time >= last + _SETTLING
        if not at_rest.any():
            raise ScenarioError(
                f"job.end = {scenario.job.end:g} s: no posture rests for {_SETTLING:g} s, after "
                "which errors are measured",
                "job.end",
            )
        posture = run.signals.get("truth.posture")
        return cls(
            run,
            in_deg_and_mm(measured_posture(run, scenario) if posture is None else posture),
            in_deg_and_mm(state[:, :3]),
            at_rest=at_rest,
            moving=changing & (run.time >= began),
        )

    @property
    def error(self) -> NDArray[np.float64]:
        return self.posture - self.desired

    @property
    def moving_error(self) -> float:
        """Root mean square of the inclination's error while moving [deg]."""
        return float(np.sqrt((self.error[self.moving, :2] ** 2).sum(axis=1).mean()))


@dataclass(frozen=True)
class Runs:
    """The three machines; a real one takes the place of the second and third.

    Attributes:
        nominal: legs as drawn; None for a real machine.
        perturbed: legs as built.
        outer: legs as built, with the outer loop; the run that is watched.
    """

    nominal: _Run | None
    perturbed: _Run
    outer: _Run

    @property
    def run(self) -> Run:
        """The run that is watched."""
        return self.outer.run


class TrackPosture(LevellingExperiment[Runs]):
    """Follows the scenario's postures with three machines, or with the real one.

    The scenario's `plant.length_error_mm` and `plant.angle_error_deg` are those of the second
    and third, its `control.outer_loop_gain` and `machine.sensors.imu_delay_ms` those of the third.
    """

    backends = (*SIMULATED, "hardware")
    signals = (
        "truth.posture",
        "truth.extension",
        "posture_desired_state",
        "extension_desired_state",
    )
    takes = "40 s"

    def needed(self, scenario: LevellingScenario) -> tuple[str, ...]:
        """See `LoopExperiment`; of a real machine, what its posture is measured by."""
        measured = MEASURED if scenario.backend == "hardware" else ()
        return (*super().needed(scenario), *measured)

    def check(self, scenario: LevellingScenario) -> None:
        """Refuses a job in which there is no posture to follow.

        Raises:
            ScenarioError: names the key.
        """
        super().check(scenario)
        if not scenario.job.waypoints:
            raise ScenarioError("job.waypoints is empty: no posture is followed", "job.waypoints")

    def run(self, scenario: LevellingScenario, runner: Runner) -> Runs:
        """Lets the machines follow; the last is the one that is watched."""
        if scenario.backend == "hardware":
            return _of_real_machine(self, scenario, runner)
        inner = replace(scenario.control, outer_loop=False)
        prompt = replace(scenario.machine.sensors, imu_delay_ms=0.0)
        machine = replace(scenario.machine, sensors=prompt)
        perturbed = replace(scenario, control=inner, machine=machine)
        as_drawn = replace(scenario.plant, length_error_mm=0.0, angle_error_deg=0.0)
        nominal = replace(perturbed, plant=as_drawn)
        return Runs(
            _Run.from_run(nominal, self.run_loop(nominal, runner, watched=False)),
            _Run.from_run(perturbed, self.run_loop(perturbed, runner, watched=False)),
            _Run.from_run(_outer(scenario), self.run_loop(_outer(scenario), runner)),
        )

    def measure(self, scenario: LevellingScenario, data: Runs) -> Iterator[Metric]:
        """Errors at rest and while moving, and the outer loop's stability margins."""
        if data.nominal is None:
            yield from _real_machine_metrics(scenario, data)
            return
        yield from _errors(data.nominal, "", _bounds(scenario), "legs as drawn")
        yield from _errors(data.perturbed, "perturbed_", (None, None), "legs as built")
        yield from _errors(data.outer, "outer_loop_", (_OUTER_BOUND, None), "with the outer loop")
        yield _extension_error(data.nominal, "truth.extension", "legs as drawn")
        yield from _moving(data.nominal, data.perturbed, data.outer)
        yield from _stability(_outer(scenario))

    def note(self, scenario: LevellingScenario, data: Runs) -> Iterator[str]:
        """The source of a real machine's posture."""
        if data.nominal is None:
            yield AS_MEASURED
            yield (
                "the outer loop and these measurements use the same inertial sensor, so that its "
                "bias does not show here"
            )

    def draw(self, scenario: LevellingScenario, data: Runs) -> Iterator[Figure]:
        """Postures and extensions (Figs. 20 to 22), and the outer loop's Bode plot."""
        began = scenario.job.estimate_at + scenario.job.settled_after
        compared = data.nominal, data.perturbed, data.outer
        yield from _tracking(*compared, began, _bounds(scenario))
        if data.nominal is not None:
            yield _bode(_outer(scenario))


def _of_real_machine(
    experiment: TrackPosture, scenario: LevellingScenario, runner: Runner
) -> Runs:
    """The machine follows twice; the second time the outer loop corrects it."""
    inner = replace(scenario, control=replace(scenario.control, outer_loop=False))
    without = _Run.from_run(inner, experiment.run_loop(inner, runner, watched=False))
    with_loop = _Run.from_run(_outer(scenario), experiment.run_loop(_outer(scenario), runner))
    return Runs(None, without, with_loop)


def _bounds(scenario: LevellingScenario) -> tuple[float, float]:
    """Bounds of the angles [deg], and of the height, which goes with the machine [mm]."""
    return _PAPER[0], _PAPER[2] * scenario.machine.size


def _real_machine_metrics(scenario: LevellingScenario, data: Runs) -> Iterator[Metric]:
    (angle, height), size = _bounds(scenario), scenario.machine.size
    without, with_loop, whose = data.perturbed, data.outer, "without the outer loop"
    yield from _errors(without, "", (angle, height), whose)
    yield from _errors(with_loop, "outer_loop_", (_OUTER_BOUND, height), "with the outer loop")
    yield _extension_error(without, "legs.extension", whose, _EXTENSION_BOUND * size)
    yield from _moving_errors(without, with_loop)


def _outer(scenario: LevellingScenario) -> LevellingScenario:
    return replace(scenario, control=replace(scenario.control, outer_loop=True))


def _errors(
    run: _Run, prefix: str, bounds: tuple[float | None, float | None], whose: str
) -> list[Metric]:
    return error_metrics(run.error[run.at_rest], prefix, bounds, _PAPER, f"at rest, {whose}")


def _extension_error(run: _Run, port: str, whose: str, bound: float | None = None) -> Metric:
    signals, counts = run.run, run.at_rest | run.moving
    desired = signals["extension_desired_state"][counts, :LEG_COUNT]
    error = np.abs(signals[port][counts] - desired).max()
    return Metric(
        "extension_error_mm",
        1e3 * float(error),
        "mm",
        bound,
        paper="almost perfect",
        meaning=f"largest error of any actuator against its reference, {whose}",
    )


def _moving(nominal: _Run, perturbed: _Run, outer: _Run) -> list[Metric]:
    largest = np.abs(nominal.error[nominal.moving, :2]).max()
    return [
        Metric(
            "moving_error_deg",
            float(largest),
            "deg",
            _PAPER[0],
            paper=_PAPER[0],
            meaning="largest error of roll and pitch while moving, legs as drawn",
        ),
        *_moving_errors(perturbed, outer),
    ]


def _moving_errors(perturbed: _Run, outer: _Run) -> list[Metric]:
    return [
        Metric(
            "perturbed_moving_rms_deg",
            perturbed.moving_error,
            "deg",
            meaning="largest inclination error while moving, legs as built",
        ),
        Metric(
            "outer_loop_moving_rms_deg",
            outer.moving_error,
            "deg",
            meaning="largest inclination error while moving, with the outer loop",
        ),
        Metric(
            "outer_loop_moving_ratio",
            outer.moving_error / perturbed.moving_error,
            meaning="ratio of the inclination error while moving, with the outer loop to without",
        ),
        Metric(
            "outer_loop_moving_loss_deg",
            max(0.0, outer.moving_error - perturbed.moving_error),
            "deg",
            _SENSOR,
            meaning="increase of the inclination error by the outer loop, while moving",
        ),
    ]


def _stability(scenario: LevellingScenario) -> list[Metric]:
    """Smallest margins over gains of the actuators, delays and both axes."""
    limits = [
        axis
        for scale in _GAIN_SCALES
        for loop in [open_loop(scenario, scale)]
        for delay in _DELAYS
        for axis in margins(loop, delay + sample_period())
    ]
    condition = "for K +-15 % and up to 20 ms of delay beside the sampling"
    return [
        Metric(
            "gain_margin_dB",
            min(axis.gain_db for axis in limits),
            "dB",
            at_least=_GAIN_MARGIN,
            meaning=f"smallest gain margin {condition}",
        ),
        Metric(
            "phase_margin_deg",
            math.degrees(min(axis.phase for axis in limits)),
            "deg",
            at_least=_PHASE_MARGIN,
            meaning=f"smallest phase margin {condition}",
        ),
        Metric(
            "crossover_rad_s",
            max(axis.crossover for axis in limits),
            "rad/s",
            meaning="largest frequency at which the loop's gain is 1",
        ),
    ]


def _tracking(
    nominal: _Run | None,
    perturbed: _Run,
    outer: _Run,
    began: float,
    bounds: tuple[float, float],
) -> tuple[Figure, ...]:
    scenario_compared, name, port = nominal, "true", "truth.extension"
    if scenario_compared is None:
        scenario_compared, name, port = perturbed, "measured", "legs.extension"
    lines = {
        "asked for": scenario_compared.desired,
        **({} if nominal is None else {"as drawn": nominal.posture}),
        "as built": perturbed.posture,
        "as built, outer loop": outer.posture,
    }

    def extensions(canvas: "Canvas") -> None:
        left, right = canvas.subplots(1, 2)
        time, signals = scenario_compared.run.time, scenario_compared.run
        extension = 1e3 * signals[port]
        desired = 1e3 * signals["extension_desired_state"][:, :4]
        for leg in range(4):
            left.plot(time, extension[:, leg], label=f"leg {leg + 1}")
        left.set(xlabel="time [s]", ylabel="extension [mm]")
        left.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, fontsize=8)
        controlled = signals["extension_desired_state"][:, 0] > 0.0
        right.plot(time[controlled], desired[controlled, 0], linewidth=2.2, label="asked for")
        right.plot(
            time[controlled],
            extension[controlled, 0],
            linewidth=1.0,
            label=name,
        )
        right.set(xlabel="time [s]", ylabel="extension of leg 1 [mm]")
        right.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize=8)

    return (
        posture_figure(
            "fig20_21",
            "Postures followed",
            "Roll, pitch and height by the closed loop (the paper's Figs. 20 and 21).",
            scenario_compared.run.time,
            lines,
            "asked for",
            began,
            bounds,
        ),
        Figure(
            "fig22",
            "Extensions of the actuators",
            "All four, and how leg 1 follows its reference (the paper's Fig. 22).",
            extensions,
        ),
    )


def _bode(scenario: LevellingScenario) -> Figure:
    delay = _DELAYS[-1] + sample_period()
    loops = {scale: open_loop(scenario, scale) for scale in _GAIN_SCALES}

    def draw(canvas: "Canvas") -> None:
        upper, lower = canvas.subplots(2, 1, sharex=True)
        for scale, loop in loops.items():
            frequency = np.geomspace(1e-2, 0.99 * math.pi / loop.period, 600)
            gain = alone(loop.response(frequency, delay), 0)
            label = f"K {100 * (scale - 1):+.0f} %"
            upper.semilogx(frequency, 20.0 * np.log10(np.abs(gain)), label=label)
            lower.semilogx(frequency, np.degrees(np.unwrap(np.angle(gain))))
        upper.axhline(0.0, color="black", linewidth=0.8)
        lower.axhline(-180.0, color="black", linewidth=0.8)
        upper.set_ylabel("gain [dB]")
        lower.set(xlabel="frequency [rad/s]", ylabel="phase [deg]", ylim=(-270.0, -80.0))
        upper.legend(fontsize=8)

    caption = "Open loop of the roll correction with 20 ms of delay; pitch is the same."
    return Figure("outer_loop_bode", "The outer loop's margins", caption, draw, (7.0, 4.0))
