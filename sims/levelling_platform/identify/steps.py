"""Voltage steps of the actuators, and the gains that recordings of them show."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.systems.core.schema import Schema, quantity
from parapod.systems.levelling_platform.geometry import LEG_COUNT

FEWEST_SAMPLES = 5  # samples that make a ramp


@dataclass
class StepsScenario(Schema):
    """The voltage steps.

    Attributes:
        voltages: voltages of the ten steps; positive ones extend the actuators, which lowers the
            platform [V]; null: .75 to 3 V, by the voltage that lifts the platform, so that
            friction and load count as much in a step as with the paper's.
        travel_mm: way of a nominal actuator in each step, so that small voltages last longer [mm];
            null: two fifths of the stroke on the ground.
        rest_s: time at 0 V before, between and after the steps [s].
        transient_s: beginning of each step that does not count for its slope [s].
        initial_extension_mm: extension of all legs at the beginning [mm]; null: a fifth of the
            stroke on the ground.
        period: period of the log [s]; a real machine's is that of its controller.
        lifted_extension_mm: extension of a real machine's legs at the beginning of the steps
            without load, at which the feet are in the air [mm]; null: three eighths of the way
            from the stroke on the ground to the end stop.
        edge_s: duration of each rise and fall of a real machine's voltages [s]; at once, its guard
            would take what drives lag behind for drives that do not obey.
        lowering_mm_s: largest rate of a real machine's legs on their way to the ground [mm/s];
            the paper's feet are some six times as fast; null: that of the supervised operation.
    """

    voltages: list[float] | None = quantity(None, -1000.0, 1000.0, length=10)
    travel_mm: float | None = quantity(None, 0.01, 20_000.0)
    rest_s: float = quantity(0.3, 0.1, 5.0)
    transient_s: float = quantity(0.1, 0.0, 1.0)
    initial_extension_mm: float | None = quantity(None, 0.1, 20_000.0)
    period: float = quantity(0.01, 0.001, 0.05)
    lifted_extension_mm: float | None = quantity(None, 0.1, 20_000.0)
    edge_s: float = quantity(0.3, 0.1, 1.0)
    lowering_mm_s: float | None = quantity(None, 0.01, 1000.0)

    def plan(self, machine: PlatformDesign) -> "StepPlan":
        """The steps of a machine; what is null follows from it."""
        low, high = machine.geometry.extension_min, machine.geometry.extension_max
        travel, initial, lifted, lowering = (
            1e-3 * (round(1e3 * usual, 3) if own_mm is None else own_mm)
            for own_mm, usual in (
                (self.travel_mm, _TRAVEL * (high - low)),
                (self.initial_extension_mm, low + _INITIAL * (high - low)),
                (self.lifted_extension_mm, machine.beyond_stroke(_LIFTED)),
                (self.lowering_mm_s, machine.supervisor.lowering_rate),
            )
        )
        voltages = self.voltages
        if voltages is None:
            by_friction = machine.friction_voltages[1] / PlatformDesign().friction_voltages[1]
            voltages = [round(by_friction * volts, 2) for volts in _VOLTAGES]
        return StepPlan(
            gain=machine.actuators.params.gain,
            voltages=tuple(voltages),
            travel=travel,
            rest=self.rest_s,
            transient=self.transient_s,
            edge=self.edge_s,
            period=self.period,
            initial_extension=initial,
            lifted_extension=lifted,
            lowering_rate=lowering,
        )


# Voltages of the steps of the paper's platform [V].
_VOLTAGES = (0.75, -1.0, 1.25, -1.5, 1.75, -2.0, 2.25, -2.5, 2.75, -3.0)
# Shares of the stroke on the ground, and of the way from there to the end stop [-].
_TRAVEL, _INITIAL, _LIFTED = 0.4, 0.2, 0.375


@dataclass(frozen=True)
class StepPlan:
    """The voltage steps of a machine.

    Attributes:
        gain: nominal K of Eq. (18) [(m/s)/V].
        voltages: voltage of each step [V].
        travel: way of a nominal actuator in each step [m].
        rest: time at 0 V before, between and after the steps [s].
        transient: beginning of each step that does not count [s].
        edge: duration of each rise and fall of a real machine's voltages [s].
        period: period of the log [s].
        initial_extension: extension of all legs on the ground [m].
        lifted_extension: extension of a real machine's legs in the air [m].
        lowering_rate: largest rate of a real machine's legs on their way to the ground [m/s].
    """

    gain: float
    voltages: tuple[float, ...]
    travel: float
    rest: float
    transient: float
    edge: float
    period: float
    initial_extension: float
    lifted_extension: float
    lowering_rate: float


@dataclass(frozen=True)
class Recording:
    """Recording of a case, with the truth that only a simulation can tell.

    Attributes:
        time: (n) [s].
        voltage: (n, 4) [V].
        extension: (n, 4) of the encoders [m].
        attitude: (n, 2) roll and pitch, the true ones or those that a real machine estimates
            [rad]; None without load.
    """

    time: NDArray[np.float64]
    voltage: NDArray[np.float64]
    extension: NDArray[np.float64]
    attitude: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Steps:
    """Gains that the steps of a recording show.

    Attributes:
        voltage: (steps) [V].
        speed: (steps, 4) slope of each ramp [m/s].
    """

    voltage: NDArray[np.float64]
    speed: NDArray[np.float64]

    @property
    def gain(self) -> NDArray[np.float64]:
        """(steps, 4) K of each step and leg, the paper's: friction counts as gain [(m/s)/V]."""
        return self.speed / self.voltage[:, None]

    def deviation_percent(self, nominal: float) -> float:
        """Largest deviation of a step's K from the nominal one [(m/s)/V], of any leg [%]."""
        return 100.0 * float(np.abs(self.gain / nominal - 1.0).max())

    @property
    def spread_percent(self) -> float:
        """Between the largest and the smallest mean K of a leg, in % of their mean."""
        means = self.gain.mean(axis=0)
        return 100.0 * float(np.ptp(means) / means.mean())


@dataclass(frozen=True)
class Separated:
    """Gain and friction of each leg.

    Attributes:
        gain: (4) K [(m/s)/V].
        extending: (4) voltage that friction and load take when the actuator extends [V].
        retracting: (4) the same when it retracts, which lifts the platform [V].
    """

    gain: NDArray[np.float64]
    extending: NDArray[np.float64]
    retracting: NDArray[np.float64]


def schedule(plan: StepPlan) -> PiecewisePolynomial:
    """Voltage over time, constant between the knots; the last knot is the end."""
    times, values = [0.0], [0.0]
    now = plan.rest
    for voltage in plan.voltages:
        times += [now, now + step_duration(plan, voltage)]
        values += [voltage, 0.0]
        now = times[-1] + plan.rest
    knots = [*times, now]
    return PiecewisePolynomial.ZeroOrderHold(knots, [[*values, 0.0]] * LEG_COUNT)


def eased_schedule(plan: StepPlan) -> PiecewisePolynomial:
    """The same for a real machine, whose voltages rise and fall within `edge` each."""
    times, values = [0.0], [0.0]
    now = plan.rest
    for voltage in plan.voltages:
        for lasts, level in (
            (0.0, 0.0),
            (plan.edge, voltage),
            (step_duration(plan, voltage), voltage),
            (plan.edge, 0.0),
        ):
            now += lasts
            times.append(now)
            values.append(level)
        now += plan.rest
    return PiecewisePolynomial.FirstOrderHold([*times, now], [[*values, 0.0]] * LEG_COUNT)


def step_duration(plan: StepPlan, voltage: float) -> float:
    """Duration of a step, in whole samples of the log [s]."""
    exact = plan.travel / (plan.gain * abs(voltage))
    return max(1, round(exact / plan.period)) * plan.period


def find_steps(recording: Recording, transient: float) -> Steps:
    """Slope of each voltage step's ramp by least squares, from voltages and encoders alone.

    Args:
        recording: recording of ten steps or of any number of them.
        transient: beginning of each step that does not count [s].
    """
    time, voltage = recording.time, recording.voltage[:, 0]
    edges = np.flatnonzero(np.diff(voltage)) + 1
    voltages, speeds = [], []
    for begin, end in pairwise([0, *edges.tolist(), time.size]):
        if voltage[begin] == 0.0:
            continue
        # Parts of a rise or fall are not steps.
        if end - begin < FEWEST_SAMPLES:
            continue
        ramp = slice(begin + int(np.searchsorted(time[begin:end], time[begin] + transient)), end)
        voltages.append(voltage[begin])
        speeds.append(np.polyfit(time[ramp], recording.extension[ramp], 1)[0])
    return Steps(np.array(voltages), np.array(speeds))


def separate_friction(steps: Steps) -> Separated:
    """Fits speed = K (V - V_c sign V) to each leg, with a V_c of its own for each direction.

    A load takes more from the steps that lift it than a self-locking screw gives back to those
    that lower it. A direction without steps has V_c = 0.
    """
    columns = [steps.voltage, -1.0 * (steps.voltage > 0.0), 1.0 * (steps.voltage < 0.0)]
    gain, extending, retracting = np.linalg.lstsq(np.column_stack(columns), steps.speed)[0]
    return Separated(gain, extending / gain, retracting / gain)
