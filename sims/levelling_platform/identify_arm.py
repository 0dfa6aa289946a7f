"""Identify frequency and damping of the arm's rod from encoders and voltages of the legs.

No sensor is on the rod, and nothing drives the arm: the legs jerk the platform, so that the rod
swings, and lift it slowly while it does. Self-locking legs at rest hold whatever the rod does, and
the inertial sensor feels next to nothing. A leg that lifts turns at a speed that its load changes:
controllers of the position answer with voltages in which the rod's vibration is plain.

One jerk and lift is about the pitch axis, for the plane in which the arm leans, and one about the
roll axis, for the plane across. Both vibrations are fitted to the voltages of all legs, after what
a polynomial of time explains.

A real machine begins on level ground, on its feet, with the arm upright.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.leg_control import make_leg_controller
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import SIMULATED, LevellingScenario
from parapod.diagrams.wiring import named_source
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.run import Run, realtime_metric
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.leg_job import LegWatch, carry_out, refuse_unless_standing
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.arm.ringing import Ringing, fit_ringing
from parapod.systems.core.errors import ScenarioError, UnreachablePosture
from parapod.systems.levelling_platform.kinematics import inverse_kinematics

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

AXES = ("pitch", "roll")
# Time until the legs are led, to get to the first posture, and largest rate on the way [s, m/s].
_BEGINS, _ARRIVES, _RATE = 0.5, 4.0, 4e-3
# Angle and duration of a jerk [rad, s]; duration of lifting and of lowering [s].
_ANGLE, _JERK, _LIFT, _LOWER, _REST = math.radians(1.2), 0.24, 6.0, 4.0, 0.5
# Beginning and end of lifting that are left out, while the legs begin to move and stop [s].
_EDGE = 0.7
# Places between lowest and highest level posture from which, and to which, the platform lifts [-].
_FROM, _TO = 0.22, 0.75
# Frequencies that are looked for [Hz]; those of planes that differ by less are one [-].
_LOWEST, _HIGHEST, _ALIKE = 0.8, 10.0, 0.01
# Largest error of the frequency [%]; least ratio of the vibration to noise, in the best leg [-].
_BOUND, _LEAST = 5.0, 6.0


@dataclass(frozen=True)
class Rung:
    """A run and the vibrations in it.

    Attributes:
        run: the run.
        by_axis: vibration after a jerk about each axis, in the voltages (4) of the legs.
        gyro: ratio of the vibration to noise in the gyro's axes, for each jerk [-].
    """

    run: Run
    by_axis: dict[str, Ringing]
    gyro: dict[str, float]


class _StandingWatch(LegWatch):
    """Watch of a platform that begins on its feet."""

    def check_beginning(self) -> None:
        """See `LegWatch`."""
        refuse_unless_standing(self)


class IdentifyArm(LoopExperiment[LevellingScenario, Rung]):
    """Jerks the platform, lifts it, and finds the rod's vibration in the legs' voltages."""

    machine = PLATFORM
    schema = LevellingScenario
    backends = (*SIMULATED, "hardware")
    signals = ("legs.voltage", "imu.gyro", "truth.tip_deflection")
    takes = "15 s"

    def check(self, scenario: LevellingScenario) -> None:
        """Refuses a simulated arm that is rigid, sloped ground, and legs that are too short.

        Raises:
            ScenarioError: names the key.
        """
        super().check(scenario)
        if scenario.backend != "hardware" and scenario.machine.arm.bending is None:
            raise ScenarioError("machine.arm must bend: it must be !FlexibleRod", "machine.arm")
        if any(scenario.ground.inclination):
            key = "ground.roll_deg"
            raise ScenarioError(f"{key} and ground.pitch_deg must be 0: legs are led on it", key)
        try:
            request_of(scenario)
        except UnreachablePosture as error:
            raise ScenarioError(f"machine: the stroke is too short: {error}", "machine") from None

    def duration(self, scenario: LevellingScenario) -> float:
        """End of the last lift [s]."""
        return _lifts()[-1] + _LIFT

    def loop(self, scenario: LevellingScenario, **options: Any) -> ClosedLoop[LevellingScenario]:
        """The machine whose legs are led through jerks and lifts."""
        enable = PiecewisePolynomial.ZeroOrderHold([0.0, _BEGINS, 1e6], [[0.0, 1.0, 1.0]])
        sources = (
            named_source("extension_request", request_of(scenario), derivatives=1),
            named_source("legs_enable", enable),
        )
        options.setdefault("controller", make_leg_controller(scenario, _RATE))
        return ClosedLoop(PLATFORM, scenario, sources=sources, **options)

    def run(self, scenario: LevellingScenario, runner: Runner) -> Rung:
        """Jerks and lifts, and fits a vibration to each lift.

        Raises:
            RefusedRequest: a machine that does not stand on its feet.
        """
        # The guard then lets the platform turn as fast as the jerks do.
        control = replace(scenario.control, arm_damping_by_legs="feedforward")
        agile = replace(scenario, control=control)
        run = carry_out(self, agile, runner, _StandingWatch).run
        rung, gyro = {}, {}
        for axis, begin in zip(AXES, _lifts(), strict=True):
            counts = (run.time >= begin + _EDGE) & (run.time <= begin + _LIFT - _EDGE)
            low, high = 2.0 * math.pi * _LOWEST, 2.0 * math.pi * _HIGHEST
            time = run.time[counts]
            rung[axis] = fit_ringing(time, run["legs.voltage"][counts], low, high)
            felt = fit_ringing(
                time,
                run["imu.gyro"][counts, :2],
                0.99 * rung[axis].frequency,
                1.01 * rung[axis].frequency,
            )
            gyro[axis] = float(felt.ratios.max())
        return Rung(run, rung, gyro)

    def measure(self, scenario: LevellingScenario, data: Rung) -> Iterator[Metric]:
        """Frequencies, damping and how plain the vibration is; errors where the rod is known."""
        rod = scenario.machine.arm.bending
        for axis, plane in zip(AXES, (0, 1), strict=True):
            ringing = data.by_axis[axis]
            hertz = ringing.frequency / (2.0 * math.pi)
            meaning = f"number of vibrations a second after the jerk about the {axis} axis"
            yield Metric(f"{axis}_frequency_Hz", hertz, "Hz", meaning=meaning)
            if rod is not None and scenario.backend != "hardware":
                true = rod.loaded_frequencies(scenario.machine.masses.gravity)[plane, 0]
                yield Metric(
                    f"{axis}_frequency_error_percent",
                    100.0 * abs(ringing.frequency / true - 1.0),
                    "%",
                    _BOUND,
                    meaning=f"error of the frequency after the jerk about the {axis} axis",
                )
            yield Metric(
                f"{axis}_signal_to_noise",
                float(ringing.ratios.max()),
                at_least=_LEAST,
                meaning=f"ratio of the {axis} jerk's vibration to noise, in the best voltage",
            )
            yield Metric(
                f"{axis}_gyro_signal_to_noise",
                data.gyro[axis],
                meaning=f"ratio of the {axis} jerk's vibration to noise in the gyro",
            )
        damping = _damping(data)
        yield Metric("damping_ratio", damping, meaning="mean damping ratio of both")
        yield realtime_metric(data.run)

    def identified(self, scenario: LevellingScenario, data: Rung) -> Mapping[str, Any]:
        """Frequencies and damping, as shapers and legs take them."""
        hertz = sorted(data.by_axis[axis].frequency / (2.0 * math.pi) for axis in AXES)
        if hertz[1] <= (1.0 + _ALIKE) * hertz[0]:
            hertz = [0.5 * (hertz[0] + hertz[1])]
        return {
            "control.arm_frequencies_Hz": [round(frequency, 4) for frequency in hertz],
            "control.arm_damping_ratio": round(_damping(data), 4),
        }

    def note(self, scenario: LevellingScenario, data: Rung) -> Iterator[str]:
        """The reason for which the legs lift."""
        yield "legs at rest lock, and feel nothing of the rod: its vibration is that of the lifts"

    def draw(self, scenario: LevellingScenario, data: Rung) -> Iterator[Figure]:
        """Voltages of the lifts."""
        yield _figure(data)


def _lifts() -> tuple[float, float]:
    """Times at which the lifts begin [s]."""
    first = _ARRIVES + _JERK
    return first, first + _LIFT + _LOWER + _REST + _JERK


def request_of(scenario: LevellingScenario) -> PiecewisePolynomial:
    """Extensions (4) of jerks and lifts, over time.

    Raises:
        UnreachablePosture: a stroke that is too short.
    """
    lowest, highest = scenario.machine.level_heights
    low, high = (lowest + share * (highest - lowest) for share in (_FROM, _TO))
    postures: list[NDArray[np.float64]] = []
    times: list[float] = []

    def go(until: float, begin: tuple[float, ...], end: tuple[float, ...]) -> None:
        """Goes from one posture to another, at rest at both."""
        start = times[-1] if times else 0.0
        count = round((until - start) / scenario.control.period)
        s = np.linspace(0.0, 1.0, count + 1)[1:, np.newaxis]
        share = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        times.extend((start + s[:, 0] * (until - start)).tolist())
        postures.extend(np.array(begin) + share * (np.array(end) - np.array(begin)))

    level = 0.0, 0.0, low
    for axis, begin in zip(AXES, _lifts(), strict=True):
        tilt = (0.0, _ANGLE) if axis == "pitch" else (_ANGLE, 0.0)
        go(begin - _JERK, level, level)
        go(begin, level, (*tilt, low))
        go(begin + _LIFT, (*tilt, low), (*tilt, high))
        if axis != AXES[-1]:
            go(begin + _LIFT + _LOWER, (*tilt, high), level)
    extensions = inverse_kinematics(scenario.geometry_as_known, postures, [0.0, 0.0])
    knots: Any = np.concatenate([[0.0], times, [times[-1] + 1e6]])
    samples: Any = np.vstack([extensions[:1], extensions, extensions[-1:]])
    rates: Any = np.gradient(samples[:-1], knots[:-1], axis=0)
    rates = np.vstack([rates, np.zeros((1, 4))])
    rates[-2] = 0.0
    return PiecewisePolynomial.CubicHermite(knots, samples.T, rates.T)


def _damping(data: Rung) -> float:
    return float(np.mean([ringing.damping_ratio for ringing in data.by_axis.values()]))


def _figure(data: Rung) -> Figure:
    run = data.run

    def draw(canvas: "Canvas") -> None:
        rows = canvas.subplots(2, 1)
        for axes, axis, begin in zip(rows, AXES, _lifts(), strict=True):
            lift = run.after(begin + _EDGE)
            counts = lift.time <= begin + _LIFT - _EDGE
            time = lift.time[counts] - begin
            for leg, voltage in enumerate(lift["legs.voltage"][counts].T, start=1):
                smooth = np.polynomial.Polynomial.fit(time, voltage, 8)(time)
                axes.plot(time, 1e3 * (voltage - smooth), linewidth=1.0, label=f"leg {leg}")
            axes.set_ylabel(f"after {axis} [mV]")
        rows[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)
        rows[1].set_xlabel("time from the beginning of the lift [s]")

    return Figure(
        "identify_arm",
        "The rod's vibration in the legs' voltages",
        "Voltages while the platform lifts, less their trend.",
        draw,
        (8.0, 4.6),
    )
