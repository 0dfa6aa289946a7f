"""The part of slip that a real machine's own sensors measure: lift, brakes, arm's swing.

Encoders show how far the feet move against each other; inertial sensor and encoders show whether
the platform moves while the actuators are braked. A drift or turn of the whole platform changes
neither; the machine's own sensors cannot measure it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import System
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.levelling_platform.scenario import (
    LevellingScenario,
)
from parapod.diagrams.wiring import named_source
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.leg_job import AT_REST
from parapod.sims.levelling_platform.slip.scenario import (
    ACTUATOR_SLIP,
    HEIGHT_BOUND,
    LEVEL,
    SlipScenario,
    lift_trajectory,
    swing_trajectory,
)
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.kinematics import forward_kinematics

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas
from typing import TYPE_CHECKING

from parapod.sims.levelling_platform.leg_job import (
    LegJob,
    LegWatch,
    carry_out,
    refuse_unless_standing,
)
from parapod.systems.levelling_platform.eased_legs import easing_time
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import unevenness
from parapod.systems.levelling_platform.leg import foot_to_centre

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas


type Floats = NDArray[np.float64]

# Rest before the lift [s], and largest rate of a leg that is brought to where it begins [m/s].
_SETTLE, _RATE = 1.0, 4e-3
# Two counts of the encoders: braked actuators do not move [mm].
_HELD = 0.021
_RESIDUAL = 1.0  # residual of a foot from the plane of all four [mm]
_BEFORE = 0.5  # over which the state before the swing is averaged [s]


@dataclass(frozen=True)
class Times:
    """Times of a real machine's lift.

    Attributes:
        begin: time at which the scenario's own times begin [s].
        lift: beginning of the lift [s].
        braked: time at which the actuators are braked [s].
        swing: time at which the arm begins to swing [s].
        end: end of the job [s].
    """

    begin: float
    lift: float
    braked: float
    swing: float
    end: float

    @classmethod
    def from_scenario(cls, scenario: SlipScenario, rest: float) -> "Times":
        """The times of a scenario.

        Args:
            scenario: its own times count from where the legs have been brought.
            rest: time at rest before the lift in the scenario [s].
        """
        low, high = scenario.machine.standing_stroke
        start = scenario.levelling.initial_extensions
        begin = AT_REST + easing_time(max(max(start) - low, high - min(start)), _RATE) + _SETTLE
        return cls(
            begin,
            begin + rest,
            begin + scenario.braked_at,
            begin + scenario.swing_at,
            begin + scenario.end,
        )


@dataclass(frozen=True)
class Measured:
    """A real machine's lift.

    Attributes:
        times: see `Times`.
        has_arm: true if there is an arm that has swung.
        geometry: the machine as its controller knows it.
        time: (n) [s].
        extension: (n, 4) with the encoders' offsets [m].
        attitude: (n, 2) estimated roll and pitch [rad].
        turn_rate: (n) measured about the platform's z axis [rad/s].
    """

    times: Times
    has_arm: bool
    geometry: PlatformGeometry
    time: Floats
    extension: Floats
    attitude: Floats
    turn_rate: Floats

    def between(self, since: float, until: float) -> NDArray[np.bool_]:
        """(n) the samples from one time to another [s]."""
        return (self.time >= since - 1e-9) & (self.time <= until + 1e-9)

    @property
    def spread(self) -> Floats:
        """(n, 4) by how much each foot has moved against the others since the lift began [m].

        In the plane of the feet, less what is common to all: their mean, and their turn about it.
        """
        feet = _in_plane(self.geometry, self.extension)
        feet -= feet.mean(axis=1, keepdims=True)
        first = feet[int(np.argmax(self.time >= self.times.lift))]
        # The turn that brings them nearest to where they were.
        cross = (feet[..., 0] * first[:, 1] - feet[..., 1] * first[:, 0]).sum(axis=1)
        along = (feet * first).sum(axis=(1, 2))
        c, s = np.cos(np.arctan2(cross, along)), np.sin(np.arctan2(cross, along))
        rotations = np.stack(
            [
                c[:, None] * feet[..., 0] - s[:, None] * feet[..., 1],
                s[:, None] * feet[..., 0] + c[:, None] * feet[..., 1],
            ],
            axis=-1,
        )
        distance: Floats = np.linalg.norm(rotations - first, axis=-1)
        return distance


def _in_plane(geometry: PlatformGeometry, extension: Floats) -> Floats:
    """Places (n, 4, 2) of the feet in the plane that fits them best, in the platform's heading."""
    posture = forward_kinematics(geometry, extension, LEVEL)
    feet = np.empty((len(extension), LEG_COUNT, 3))
    for i, leg in enumerate(geometry.legs):
        feet[:, i] = -np.stack(np.broadcast_arrays(*foot_to_centre(leg, extension[:, i])), -1)
    roll, pitch = posture[:, 0], posture[:, 1]
    x, y, z = feet[..., 0], feet[..., 1], feet[..., 2]
    cr, sr = np.cos(roll)[:, None], np.sin(roll)[:, None]
    cp, sp = np.cos(pitch)[:, None], np.sin(pitch)[:, None]
    across = sr * y + cr * z
    return np.stack([cp * x + sp * across, cr * y - sr * z], axis=-1)


class _LiftWatch(LegWatch):
    """Refuses a machine that does not begin on its feet."""

    def check_beginning(self) -> None:
        """See `LegWatch`."""
        refuse_unless_standing(self)


def measure_lift(
    scenario: SlipScenario, machine: LevellingScenario, times: Times, runner: Runner
) -> Measured:
    """Lifts a machine that stands on its feet, brakes it, and swings its arm if it has one.

    Args:
        scenario: the scenario.
        machine: the machine.
        times: times of the job.
        runner: runs the job.

    Raises:
        RefusedRequest: the machine does not stand on its feet; nothing has moved.
        Tripped: it tilts, or its guard has found what cannot be.
    """
    job = LegJob(runner.name, partial(lift_sources, scenario, times), times.end, _RATE)
    watch = carry_out(job, machine, runner, _LiftWatch)
    control = machine.control
    return Measured(
        times,
        machine.has_arm,
        machine.geometry_as_known,
        control.period * np.arange(len(watch.rows["t"]), dtype=float),
        watch.column("legs.extension") + control.encoder_offsets,
        watch.column("attitude_estimated"),
        watch.column("imu.gyro")[:, 2],
    )


def lift_sources(scenario: SlipScenario, times: Times) -> tuple[System, ...]:
    """Sources for a real machine, which is brought to where the lift begins first."""
    control = PiecewisePolynomial.ZeroOrderHold(
        [0.0, AT_REST, times.braked, times.end + 1.0], [[0.0, 1.0, 0.0, 0.0]]
    )
    movements = {"extension_request": (lift_trajectory(scenario), 1)}
    if scenario.levelling.machine.masses.arm.count:
        movements["arm.position_command"] = swing_trajectory(scenario), 0
    sources: list[System] = [named_source("legs_enable", control)]
    for name, (trajectory, derivatives) in movements.items():
        trajectory.shiftRight(times.begin)
        sources.append(named_source(name, _held_before(trajectory), derivatives))
    return tuple(sources)


def _held_before(trajectory: PiecewisePolynomial) -> PiecewisePolynomial:
    """A trajectory that begins later, with its first value from 0 on."""
    first = trajectory.value(trajectory.start_time())
    spline = PiecewisePolynomial.CubicHermite(
        [0.0, trajectory.start_time()],
        np.hstack([first, first]).tolist(),
        [[0.0] * 2] * first.size,
    )
    spline.ConcatenateInTime(trajectory)
    return spline


def measured_metrics(scenario: SlipScenario, data: Measured) -> Iterator[Metric]:
    """Everything that is measured.

    Args:
        scenario: the scenario.
        data: the lift.
    """
    times, (least, most) = data.times, ACTUATOR_SLIP
    lifting = data.between(times.lift, times.braked)
    yield Metric(
        "actuator_slip_mm",
        1e3 * float(data.spread[lifting].max()),
        "mm",
        most,
        paper=3.0,
        at_least=least,
        meaning="largest slip of a foot against the others while the platform is lifted, by "
        "the encoders",
    )
    at = int(np.argmax(data.time >= times.swing))
    height = float(forward_kinematics(data.geometry, data.extension[at], LEVEL)[2])
    yield Metric(
        "lift_height_error_mm",
        1e3 * height - 1e3 * scenario.height,
        "mm",
        HEIGHT_BOUND * scenario.machine.size,
        meaning="error of the height when the arm begins to swing, by the encoders",
    )
    until = data.between(times.lift, times.swing)
    tilt = np.degrees(np.abs(data.attitude[until] - data.attitude[until][0]).max())
    meaning = "largest change of roll or pitch until the swing, by the inertial sensor"
    yield Metric("lift_tilt_deg", float(tilt), "deg", meaning=meaning)
    residual = np.abs(unevenness(data.geometry, data.extension[until]))
    yield Metric(
        "foot_residual_mm",
        1e3 * float(residual.max()),
        "mm",
        _RESIDUAL,
        meaning="largest distance of a foot from the plane of all four, by the encoders",
    )
    # The rods come to rest first.
    standing = data.extension[data.between(times.braked + 0.1, times.end)]
    yield Metric(
        "braked_motion_mm",
        1e3 * float(np.ptp(standing, axis=0).max()),
        "mm",
        _HELD,
        meaning="largest motion of a braked actuator, by its encoder",
    )
    if data.has_arm:
        yield from _swing_metrics(data)


def _swing_metrics(data: Measured) -> Iterator[Metric]:
    before = data.between(data.times.swing - _BEFORE, data.times.swing)
    after = data.between(data.times.end - _BEFORE, data.times.end)
    swing = data.between(data.times.swing, data.times.end)
    change = data.attitude[after].mean(axis=0) - data.attitude[before].mean(axis=0)
    meaning = "change of roll or pitch by the swing, by the inertial sensor"
    yield Metric(
        "arm_tilt_left_deg", float(np.degrees(np.abs(change).max())), "deg", meaning=meaning
    )
    rate = data.turn_rate[swing] - data.turn_rate[before].mean()
    period = float(np.diff(data.time).mean())
    meaning = "turn about the vertical from the swing on, by the gyro"
    yield Metric(
        "arm_turn_deg", float(np.degrees(abs(rate.sum() * period))), "deg", meaning=meaning
    )


def measured_notes(data: Measured) -> tuple[str, ...]:
    """Bounds of what can be seen."""
    arm = (
        "the gyro's noise alone turns by some hundredths of a degree in a second: slip of less "
        "than a tenth of a millimetre is not seen",
        "the machine has no arm: nothing has swung, and what the swing moves is left out",
    )
    return (
        "measured on board: the feet against each other. The platform that drifts or turns as a "
        "whole moves no encoder; that slip, that of the swing (paper: less than 0.01 mm) and the "
        "creep on a slope need an instrument outside.",
        arm[0 if data.has_arm else 1],
    )


def measured_figures(data: Measured) -> tuple[Figure, ...]:
    """Height and the feet's motion over time."""
    return (
        Figure(
            "fig23_measured",
            "Height of the platform, and motion of the feet against each other",
            "As the encoders measure them; shaded: the actuators are braked (to be compared with "
            "Fig. 23).",
            partial(_draw, data),
            (7.0, 4.6),
        ),
    )


def _draw(data: Measured, canvas: "Canvas") -> None:
    upper, lower = canvas.subplots(2, 1, sharex=True)
    counts = data.time >= data.times.lift
    time = data.time[counts] - data.times.begin
    height = forward_kinematics(data.geometry, data.extension[counts], LEVEL)[:, 2]
    upper.plot(time, 1e3 * height)
    upper.set_ylabel("height [mm]")
    for leg in range(LEG_COUNT):
        lower.plot(time, 1e3 * data.spread[counts, leg], label=f"leg {leg + 1}")
    lower.set(xlabel="time [s]", ylabel="motion of a foot [mm]")
    for axes in (upper, lower):
        since = data.times.braked - data.times.begin
        axes.axvspan(since, data.times.end - data.times.begin, color="0.92", zorder=0)
    lower.legend(fontsize=8, ncols=LEG_COUNT)
