"""Identification of the linear actuators from voltage steps: section 5.2, Figs. 13 to 15.

Ten steps of different voltage, with the legs lifted and under the platform's weight. The gain K
of Eq. (17) is estimated from what a log of the real machine would have: voltages and encoders.
"""

from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.levelling_platform.scenario import (
    ActuatorScenario,
    GroundScenario,
    JobScenario,
    LevellingScenario,
    PlantScenario,
    SensorScenario,
)
from parapod.diagrams.levelling_platform.station import make_station
from parapod.diagrams.scenario import choice, dump_scenario, quantity
from parapod.diagrams.wiring import add, connect
from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.figures import Figure
from parapod.sims.outputs import write_log
from parapod.sims.results import Metric, Result
from parapod.sims.simulate import simulate
from parapod.systems.actuators.linear_actuator import LinearActuator, LinearActuatorParams
from parapod.systems.errors import OutputError, ScenarioError
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.sensors.encoder import Encoder

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

BACKENDS = ("multibody",)
_NOMINAL = LinearActuatorParams().gain  # K of Eq. (18) [(m/s)/V]
_SHARE = 0.15  # largest deviation from it that the paper found
_STROKE = (0.385, 0.425)  # where the feet carry and the leg model holds [m]
_FEWEST_SAMPLES = 5  # that make a ramp
_CASES = ("unloaded", "loaded")


def _nominal_actuators() -> ActuatorScenario:
    return ActuatorScenario(gain_error=0.0)


@dataclass
class StepsScenario:
    """The voltage steps.

    Attributes:
        voltages: of the ten steps; positive extends the actuators, which lowers the platform
            [V].
        travel_mm: way of a nominal actuator in each step, so that small voltages last longer
            [mm].
        rest_s: at 0 V before, between and after the steps [s].
        transient_s: beginning of each step that does not count for its slope [s].
        initial_extension_mm: of all legs [mm].
        period: of the log [s].
    """

    voltages: list[float] = quantity(
        [0.75, -1.0, 1.25, -1.5, 1.75, -2.0, 2.25, -2.5, 2.75, -3.0], -12.0, 12.0, length=10
    )
    travel_mm: float = quantity(12.0, 2.0, 30.0)
    rest_s: float = quantity(0.3, 0.1, 5.0)
    transient_s: float = quantity(0.1, 0.0, 1.0)
    initial_extension_mm: float = quantity(396.0, 390.0, 420.0)
    period: float = quantity(0.01, 0.001, 0.05)


@dataclass
class IdentifyActuatorsScenario:
    """One identification of the four actuators.

    Attributes:
        backend: "multibody".
        seed: of the gains' errors, if there are any.
        steps: see `StepsScenario`.
        plant: carries the load; see `PlantScenario`.
        actuators: nominal by default; see `ActuatorScenario`.
        encoder_resolution_mm: one count of the actuators' encoders; 0 for a perfect one [mm].
    """

    backend: str = choice("multibody", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    steps: StepsScenario = field(default_factory=StepsScenario)
    plant: PlantScenario = field(default_factory=PlantScenario)
    actuators: ActuatorScenario = field(default_factory=_nominal_actuators)
    encoder_resolution_mm: float = quantity(0.01, 0.0, 1.0)

    @property
    def machine(self) -> LevellingScenario:
        """The machine on level ground."""
        return LevellingScenario(
            backend=self.backend,
            seed=self.seed,
            ground=GroundScenario(0.0, 0.0),
            plant=self.plant,
            actuators=self.actuators,
            sensors=SensorScenario(encoder_resolution_mm=self.encoder_resolution_mm),
            job=JobScenario(initial_extension_mm=self.steps.initial_extension_mm),
        )


@dataclass(frozen=True)
class Recording:
    """What is known about a case, and what only a simulation can tell.

    Attributes:
        time: (n) [s].
        voltage: (n, 4) [V].
        extension: (n, 4) of the encoders [m].
        posture: (n, 3) true roll, pitch, height [rad, rad, m]; None without load.
    """

    time: NDArray[np.float64]
    voltage: NDArray[np.float64]
    extension: NDArray[np.float64]
    posture: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Steps:
    """What the steps of a recording show.

    Attributes:
        voltage: (steps) [V].
        speed: (steps, 4) slope of each ramp [m/s].
    """

    voltage: NDArray[np.float64]
    speed: NDArray[np.float64]

    @property
    def gain(self) -> NDArray[np.float64]:
        """(steps, 4) K of each step and leg [(m/s)/V]."""
        return self.speed / self.voltage[:, None]

    @property
    def deviation_percent(self) -> float:
        """Largest deviation of a step's K from the nominal one, of any leg [%]."""
        return 100.0 * float(np.abs(self.gain / _NOMINAL - 1.0).max())

    @property
    def spread_percent(self) -> float:
        """Between the largest and the smallest mean K of a leg, in % of their mean."""
        means = self.gain.mean(axis=0)
        return 100.0 * float(np.ptp(means) / means.mean())


def identify(recording: Recording, transient: float) -> Steps:
    """Slope of each voltage step's ramp by least squares, from voltages and encoders alone.

    Args:
        recording: of ten steps or of any number of them.
        transient: beginning of each step that does not count [s].
    """
    time, voltage = recording.time, recording.voltage[:, 0]
    edges = np.flatnonzero(np.diff(voltage)) + 1
    voltages, speeds = [], []
    for begin, end in pairwise([0, *edges.tolist(), time.size]):
        if voltage[begin] == 0.0:
            continue
        ramp = slice(begin + int(np.searchsorted(time[begin:end], time[begin] + transient)), end)
        voltages.append(voltage[begin])
        speeds.append(np.polyfit(time[ramp], recording.extension[ramp], 1)[0])
    return Steps(np.array(voltages), np.array(speeds))


def run(scenario: IdentifyActuatorsScenario, options: RunOptions) -> Result:
    """Identifies the actuators without and with load.

    Raises:
        ScenarioError: steps that leave the stroke or have no ramp.
        OutputError: a file cannot be written, or an option has nothing to show.
    """
    for option in ("html", "graphviz", "meshcat"):
        if asked := getattr(options, option):
            message = f"--{option} is not supported: the steps are shown by --figures"
            raise OutputError(message, None if asked is True else asked)
    check_steps(scenario)
    recordings = (_unloaded(scenario, options), _loaded(scenario, options))
    if options.log is not None:
        _write(scenario, options, recordings)
    cases = tuple(identify(r, scenario.steps.transient_s) for r in recordings)
    return Result(
        "identify-actuators",
        scenario.backend,
        scenario.seed,
        (*_gain_metrics(*cases), *_stroke_metrics(recordings)),
        _notes(scenario),
        _figures(recordings, cases),
    )


def schedule(steps: StepsScenario) -> PiecewisePolynomial:
    """Voltage over time, constant between the knots; the last knot is the end."""
    times, values = [0.0], [0.0]
    now = steps.rest_s
    for voltage in steps.voltages:
        times += [now, now + _duration(steps, voltage)]
        values += [voltage, 0.0]
        now = times[-1] + steps.rest_s
    knots = [*times, now]
    return PiecewisePolynomial.ZeroOrderHold(knots, [[*values, 0.0]] * LEG_COUNT)


def _duration(steps: StepsScenario, voltage: float) -> float:
    """How long a step lasts, in whole samples of the log [s]."""
    exact = 1e-3 * steps.travel_mm / (_NOMINAL * abs(voltage))
    return max(1, round(exact / steps.period)) * steps.period


def check_steps(scenario: IdentifyActuatorsScenario) -> None:
    """Refuses steps that leave the stroke or have no ramp.

    Raises:
        ScenarioError: names the key.
    """
    steps = scenario.steps
    extension = 1e-3 * steps.initial_extension_mm
    for i, voltage in enumerate(steps.voltages):
        key = f"steps.voltages.{i}"
        if voltage == 0.0:
            raise ScenarioError(f"{key} = 0 is no step", key)
        if abs(voltage) > scenario.actuators.supply_voltage:
            supply = scenario.actuators.supply_voltage
            raise ScenarioError(f"{key} = {voltage:g} V is above the supply, {supply:g} V", key)
        lasts = _duration(steps, voltage)
        if lasts - steps.transient_s < _FEWEST_SAMPLES * steps.period:
            why = f"lasts {lasts:.3g} s, which leaves no ramp after steps.transient_s"
            raise ScenarioError(f"{key} = {voltage:g} V {why}", key)
        extension += _NOMINAL * voltage * lasts
        if not _STROKE[0] <= extension <= _STROKE[1]:
            why = f"would bring the legs to {1e3 * extension:.1f} mm, outside 385..425 mm"
            raise ScenarioError(f"{key} = {voltage:g} V {why}", key)


def _unloaded(scenario: IdentifyActuatorsScenario, options: RunOptions) -> Recording:
    """Case (a): the legs are lifted, so that nothing loads the actuators."""
    machine, voltage = scenario.machine, schedule(scenario.steps)
    builder = DiagramBuilder()
    actuators = add(
        builder,
        LinearActuator(
            LinearActuatorParams(
                model=scenario.actuators.model,  # type: ignore[arg-type]
                coulomb_friction=scenario.actuators.coulomb_friction,
                supply_voltage=scenario.actuators.supply_voltage,
            ),
            time_step=scenario.plant.time_step,
        ),
    )
    encoder = add(builder, Encoder(resolution=1e-3 * scenario.encoder_resolution_mm))
    source = add(builder, TrajectorySource(voltage), "voltage")
    connect(builder, source.get_output_port(), actuators.GetInputPort("voltage"))
    connect(builder, actuators.GetOutputPort("extension"), encoder.GetInputPort("position"))
    connect(builder, actuators.GetOutputPort("velocity"), encoder.GetInputPort("velocity"))
    logs = _log(builder, scenario, source, encoder.GetOutputPort("position_measured"))
    simulator = Simulator(builder.Build())
    context = actuators.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    actuators.set_extension(context, 1e-3 * scenario.steps.initial_extension_mm)
    # As `Station.reset` draws them: the same seed has the same legs in both cases.
    error = machine.actuators.gain_error
    scale = 1.0 + np.random.default_rng(scenario.seed).uniform(-error, error, LEG_COUNT)
    actuators.set_gain_scale(context, scale)
    return _simulate(simulator, voltage.end_time(), options, "without load", logs)


def _loaded(scenario: IdentifyActuatorsScenario, options: RunOptions) -> Recording:
    """Case (b): the platform stands on its legs."""
    voltage = schedule(scenario.steps)
    builder = DiagramBuilder()
    station = make_station(scenario.machine)
    machine = add(builder, station.diagram)
    source = add(builder, TrajectorySource(voltage), "voltage")
    connect(builder, source.get_output_port(), machine.GetInputPort("legs.voltage"))
    for name, value in (
        ("wheels.velocity_command", [0.0] * 4),
        ("wheels.brake", [1.0]),
        ("arm.position_command", [0.0]),
        ("turntable.position_command", [0.0]),
    ):
        idle = add(builder, ConstantVectorSource(np.array(value)), f"idle.{name}")
        connect(builder, idle.get_output_port(), machine.GetInputPort(name))
    extension = machine.GetOutputPort("legs.extension")
    logs = _log(builder, scenario, source, extension, machine.GetOutputPort("truth.posture"))
    simulator = Simulator(builder.Build())
    station.reset(simulator.get_mutable_context())
    return _simulate(simulator, voltage.end_time(), options, "with load", logs)


def _log(
    builder: DiagramBuilder,
    scenario: IdentifyActuatorsScenario,
    source: TrajectorySource,
    *ports: OutputPort,
) -> list[Any]:
    period = scenario.steps.period
    return [LogVectorOutput(p, builder, period) for p in (source.get_output_port(), *ports)]


def _simulate(
    simulator: Simulator, until: float, options: RunOptions, what: str, logs: list[Any]
) -> Recording:
    simulator.Initialize()
    simulate(simulator, until, options.console, what)
    found = [log.FindLog(simulator.get_context()) for log in logs]
    samples = [log.data().T.copy() for log in found]
    return Recording(found[0].sample_times().copy(), *samples)


def _gain_metrics(unloaded: Steps, loaded: Steps) -> tuple[Metric, ...]:
    means = [float(case.gain.mean()) for case in (unloaded, loaded)]
    low, high = (1.0 - _SHARE) * _NOMINAL, (1.0 + _SHARE) * _NOMINAL
    percent = 100.0 * _SHARE
    gains = [
        Metric(
            f"gain_{case}",
            mean,
            "(m/s)/V",
            high,
            paper=_NOMINAL,
            at_least=low,
            meaning="K of Eq. (17), mean over ten steps and four legs",
        )
        for case, mean in zip(_CASES, means, strict=True)
    ]
    effect = Metric(
        "load_effect_percent",
        100.0 * (means[1] / means[0] - 1.0),
        "%",
        percent,
        paper="very little",
        meaning="K with load against K without",
    )
    steps = [
        Metric(
            f"step_deviation_{case}_percent",
            found.deviation_percent,
            "%",
            percent,
            paper=percent,
            meaning="largest of a step's K from 0.01, any leg",
        )
        for case, found in zip(_CASES, (unloaded, loaded), strict=True)
    ]
    spread = [
        Metric(
            f"leg_spread_{case}_percent",
            found.spread_percent,
            "%",
            paper="similar",
            meaning="of the four legs' mean K, largest less smallest",
        )
        for case, found in zip(_CASES, (unloaded, loaded), strict=True)
    ]
    return (*gains, effect, *steps, *spread)


def _stroke_metrics(recordings: tuple[Recording, ...]) -> tuple[Metric, ...]:
    extension = 1e3 * np.vstack([recording.extension for recording in recordings])
    low, high = (1e3 * limit for limit in _STROKE)
    metrics = [
        Metric("smallest_extension_mm", float(extension.min()), "mm", at_least=low),
        Metric("largest_extension_mm", float(extension.max()), "mm", high),
    ]
    for recording in recordings:
        if recording.posture is not None:
            tilt = float(np.degrees(np.abs(recording.posture[:, :2])).max())
            meaning = "largest roll or pitch; no controller is at work"
            metrics.append(Metric("largest_tilt_deg", tilt, "deg", meaning=meaning))
    return tuple(metrics)


def _notes(scenario: IdentifyActuatorsScenario) -> tuple[str, ...]:
    friction = (
        "K of a step falls short of 0.01 by friction and load, which take the same voltage from "
        "every step: small steps lose the largest share, and most when they lift the platform."
    )
    if scenario.actuators.gain_error:
        return (friction, f"gains are off by up to {100 * scenario.actuators.gain_error:g} %")
    nominal = (
        "Actuators are nominal; --set actuators.gain_error=0.15 draws each gain within 15 %, "
        "which then adds to what friction takes, so that the bounds of single steps may break."
    )
    return friction, nominal


def _write(
    scenario: IdentifyActuatorsScenario, options: RunOptions, recordings: tuple[Recording, ...]
) -> None:
    """Both cases have the same times."""
    assert options.log is not None
    signals = {
        f"{case}.{name}": getattr(recording, what)
        for case, recording in zip(_CASES, recordings, strict=True)
        for name, what in (("legs.voltage", "voltage"), ("legs.extension", "extension"))
    }
    units = {name: "V" if name.endswith("voltage") else "m" for name in signals}
    metadata = {
        "experiment": "identify-actuators",
        "scenario": dump_scenario(scenario),
        "units": units,
    }
    write_log(options.log, recordings[0].time, signals, metadata)


def _figures(recordings: tuple[Recording, ...], cases: tuple[Steps, ...]) -> tuple[Figure, ...]:
    unloaded, loaded = recordings
    return (
        Figure(
            "fig13_steps_unloaded",
            "Ten voltage steps without load",
            "Applied voltage (a) and extension by the encoders (b), legs lifted (Fig. 13).",
            partial(_draw_steps, unloaded),
            (7.0, 4.2),
        ),
        Figure(
            "fig14_steps_loaded",
            "Ten voltage steps under the platform's weight",
            "Applied voltage (a) and extension by the encoders (b), feet on the ground (Fig. 14).",
            partial(_draw_steps, loaded),
            (7.0, 4.2),
        ),
        Figure(
            "fig15a_speed_over_voltage",
            "Speed of the actuators over voltage",
            "Slope of each ramp, mean of the four legs, beside K = 0.01 (m/s)/V (Fig. 15a).",
            partial(_draw_speed, cases),
        ),
        Figure(
            "fig15b_gain_per_step",
            "Gain K of each step",
            "Mean of the four legs with their range; shaded: 0.01 within 15 % (Fig. 15b).",
            partial(_draw_gain, cases),
        ),
    )


def _draw_steps(recording: Recording, canvas: "Canvas") -> None:
    upper, lower = canvas.subplots(2, 1, sharex=True)
    upper.step(recording.time, recording.voltage[:, 0], where="post")
    upper.set_ylabel("voltage [V]")
    for leg in range(LEG_COUNT):
        width = 2.8 - 0.6 * leg
        lower.plot(
            recording.time, 1e3 * recording.extension[:, leg], label=f"leg {leg + 1}", lw=width
        )
    lower.set_ylabel("extension [mm]")
    lower.set_xlabel("time [s]")
    lower.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8, ncols=LEG_COUNT)


def _draw_speed(cases: tuple[Steps, ...], canvas: "Canvas") -> None:
    axes = canvas.subplots()
    voltage = np.array([cases[0].voltage.min(), cases[0].voltage.max()])
    axes.plot(voltage, 1e3 * _NOMINAL * voltage, color="0.6", label="K = 0.01", zorder=1)
    for case, steps, marker in zip(_CASES, cases, "ox", strict=True):
        axes.scatter(
            steps.voltage, 1e3 * steps.speed.mean(axis=1), marker=marker, label=case, zorder=2
        )
    axes.set_xlabel("voltage [V]")
    axes.set_ylabel("speed [mm/s]")
    axes.legend(loc="best", fontsize=8)


def _draw_gain(cases: tuple[Steps, ...], canvas: "Canvas") -> None:
    axes = canvas.subplots()
    axes.axhspan((1.0 - _SHARE) * _NOMINAL, (1.0 + _SHARE) * _NOMINAL, color="0.92", zorder=0)
    for case, steps, marker in zip(_CASES, cases, "ox", strict=True):
        gain = steps.gain
        middle = gain.mean(axis=1)
        around = np.array([middle - gain.min(axis=1), gain.max(axis=1) - middle]).clip(min=0.0)
        number = np.arange(1, middle.size + 1)
        axes.errorbar(number, middle, around, marker=marker, ls="", capsize=3, label=case)
    axes.set_xticks(np.arange(1, cases[0].voltage.size + 1))
    axes.set_xlabel("step")
    axes.set_ylabel("K [(m/s)/V]")
    axes.legend(loc="lower right", fontsize=8)


EXPERIMENT = Experiment(
    name="identify-actuators",
    summary="Voltage steps with and without the platform's weight give the actuators' gain K.",
    scenario=IdentifyActuatorsScenario,
    backends=BACKENDS,
    run=run,
)
