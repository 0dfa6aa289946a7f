"""Identify the actuators' gain K from voltage steps with and without the platform's weight.

Section 5.2 of the paper, Figs. 13 to 15. Ten steps of different voltage, with the legs lifted and
under the platform's weight. The gain K of Eq. (17) is estimated from what a log of the real
machine would have, voltages and encoders: for each step as in the paper, and for all steps
together with friction separated from it. The real machine begins on its wheels with the legs
lifted, and stands on its feet when both cases are done.

Measured with each actuator's K off by up to 2.5 %, from the seed:

* K of each step, the paper's: slope of the ramp over the voltage; friction and load count as gain.
  Seeds 0..19: the mean is .0096 to .0098 (m/s)/V without load and .0094 to .0096 with it (paper:
  .01), 1.9 to 2.1 % less under load; the largest deviation of a step from .01 is 9.1 and 13.9 %
  (paper: 15 %).
* Spread within 15 %: with equal actuators the smallest step that lifts, 1 V, is 11.2 % short
  already, and unequal legs add up to 1 %. With 3 % the largest deviation of 200 seeds is 14.9 %;
  with 4 % one seed in twelve is beyond 15 %.
* K with friction separated: v = K (V - V_c sign V), by least squares, with one V_c for extending
  and one for retracting. K is within .08 % of the true one without load and .6 % with it, where
  the load moves from leg to leg during the steps; with gains off by up to 15 %, within .7 %. V_c
  is .05 V without load, and with it .05 to .06 V lowering and .11 V lifting.

A real machine does both cases in turn, and K is measured by the clock of the encoders' readings,
so that ticks that were left out do not count. Simulated in the same order, with gains off by up to
15 %: within .04 % without load, .3 % with it.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource

from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.parts import ActuatorScenario
from parapod.diagrams.levelling_platform.scenario import (
    BODIES,
    SIMULATED,
    ControlScenario,
    JobScenario,
    LevellingScenario,
    PlantScenario,
    emulated_hardware,
)
from parapod.diagrams.plots import Limits
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import add, connect
from parapod.sims.lab.experiment import Experiment, Logged
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.identify.measured import record_in_turn
from parapod.sims.levelling_platform.identify.steps import (
    FEWEST_SAMPLES,
    Recording,
    Separated,
    StepPlan,
    Steps,
    StepsScenario,
    find_steps,
    schedule,
    separate_friction,
    step_duration,
)
from parapod.sims.levelling_platform.leg_job import make_simulator, on_level_ground
from parapod.sims.output.drawn import LogDrawing
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.actuators.linear_actuator import LinearActuator
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.sensors.encoder import Encoder

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

CASES = ("unloaded", "loaded")
SHARE = 0.15  # largest deviation from the nominal K that the paper found
# A load that moves from leg to leg during the steps is not a constant friction; over gain errors
# of up to 15 % that puts the estimate off by 0.7 % at most [%].
_SEPARATED_BOUND = 1.0
# Difference of both cases of a real machine, whose longer steps move more load from leg to leg
# [%].
_DIFFERENCE_BOUND = 2.0
_MARKERS = ("o", "x")
# Both cases of a step stand side by side [steps].
_ASIDE = (-0.1, 0.1)


def _similar_actuators() -> PlatformDesign:
    return PlatformDesign(actuators=ActuatorScenario(gain_error=0.025))


@dataclass
class IdentifyActuatorsScenario(Schema):
    """One identification of the four actuators.

    The steps move the actuators first with the legs lifted, then under the platform's weight:
    section 5.2, Figs. 13 to 15. The paper finds each step's K within 15 % of 0.01: friction, load
    and the legs' differences together. Friction and load alone take 11.2 % of the smallest step
    that lifts, and unequal legs share the load unequally. With gains that are off by up to 3 % the
    largest deviation of 200 seeds is 14.9 %, with 4 % one seed in twelve exceeds 15 %:
    `machine.actuators.gain_error` is 0.025.

    Attributes:
        backend: plant that carries the load: "multibody" or "mujoco" (rigid bodies), or
            "kinematic" (quasi-static); or the real machine, "hardware".
        seed: seed of the errors of gains and dimensions.
        steps: see `StepsScenario`.
        plant: see `PlantScenario`; it carries the load.
        machine: see `PlatformDesign`; or a file: `!File my_machine.yaml`.
        control: see `ControlScenario`; it leads a real machine's legs to the ground.
        hardware: see `HardwareScenario`; the defaults are the emulated devices.
    """

    moved = {  # noqa: RUF012
        "actuators": "machine.actuators",
        "encoder_resolution_mm": "machine.sensors.encoder_resolution_mm",
    }

    backend: str = choice("multibody", (*SIMULATED, "hardware"))
    seed: int = quantity(0, 0, 2**31 - 1)
    steps: StepsScenario = field(default_factory=StepsScenario)
    plant: PlantScenario = field(default_factory=PlantScenario)
    machine: PlatformDesign = field(default_factory=_similar_actuators)
    control: ControlScenario = field(default_factory=ControlScenario)
    hardware: HardwareScenario = field(default_factory=emulated_hardware)

    @property
    def levelling(self) -> LevellingScenario:
        """The machine on level ground, on its feet."""
        extension = round(1e3 * self.plan.initial_extension, 3)
        return on_level_ground(self, self.machine.sensors, extension)

    @property
    def plan(self) -> StepPlan:
        """The steps in SI units."""
        return self.steps.plan(self.machine)

    @property
    def on_wheels(self) -> LevellingScenario:
        """The machine on level ground, on its wheels with the legs lifted."""
        return replace(self.levelling, job=JobScenario(start="wheels"))


@dataclass(frozen=True)
class Recordings:
    """Both cases.

    Attributes:
        unloaded: (a), the legs are lifted, so that nothing loads the actuators.
        loaded: (b), the platform stands on its legs.
        gain: (4) true K of the actuators in both, which no log tells [(m/s)/V]; None for a real
            machine.
    """

    unloaded: Recording
    loaded: Recording
    gain: NDArray[np.float64] | None


@dataclass(frozen=True)
class Identified:
    """The actuators without and with load.

    Attributes:
        recordings: both cases.
        steps: the steps of each.
        separated: gain and friction of each, apart.
    """

    recordings: Recordings
    steps: tuple[Steps, ...]
    separated: tuple[Separated, ...]


class IdentifyActuators(Experiment[IdentifyActuatorsScenario, Identified]):
    """Identifies the actuators without and with load."""

    schema = IdentifyActuatorsScenario
    machine = PLATFORM
    # Pale: the legs without load at the same time.
    drawing = LogDrawing(
        PLATFORM,
        {
            "legs.extension": "loaded.legs.extension",
            "attitude_estimated": "loaded.attitude",
            "extension_desired_state": "unloaded.legs.extension",
        },
        plots=("loaded.legs.voltage", "loaded.legs.extension", "unloaded.legs.extension"),
    )
    backends = (*SIMULATED, "hardware")
    takes = "30 s"

    def machine_scenario(self, scenario: IdentifyActuatorsScenario) -> LevellingScenario:
        """The machine as a real one begins, for its emulation."""
        return scenario.on_wheels

    def check(self, scenario: IdentifyActuatorsScenario) -> None:
        """Refuses steps that leave the stroke, have no ramp, or leave friction and K together."""
        check_steps(scenario)

    def run(self, scenario: IdentifyActuatorsScenario, runner: Runner) -> Identified:
        """Steps the voltages and estimates K from what a log of the real machine would have.

        Raises:
            RefusedRequest: a real machine that is not on its wheels with the legs lifted.
        """
        if scenario.backend == "hardware":
            pair = record_in_turn(scenario.plan, scenario.on_wheels, runner)
            recordings = Recordings(*pair, None)
        else:
            recordings = record(scenario, runner)
        transient = scenario.steps.transient_s
        steps = tuple(find_steps(r, transient) for r in (recordings.unloaded, recordings.loaded))
        return Identified(recordings, steps, tuple(separate_friction(case) for case in steps))

    def logged(self, scenario: IdentifyActuatorsScenario, data: Identified) -> Logged:
        """Voltages and encoders of both cases, which have the same times."""
        signals = {}
        cases = (data.recordings.unloaded, data.recordings.loaded)
        for name, case in zip(CASES, cases, strict=True):
            signals[f"{name}.legs.voltage"] = (case.voltage, "V")
            signals[f"{name}.legs.extension"] = (case.extension, "m")
            if case.attitude is not None:
                signals[f"{name}.attitude"] = (case.attitude, "rad")
        return data.recordings.loaded.time, signals

    def limits(self, scenario: IdentifyActuatorsScenario) -> Limits:
        """Supply and stroke, of both cases."""
        limits = super().limits(scenario)
        both = ("legs.voltage", "legs.extension")
        return {**limits, **{f"{case}.{name}": limits[name] for case in CASES for name in both}}

    def measure(self, scenario: IdentifyActuatorsScenario, data: Identified) -> Iterator[Metric]:
        """Gains of the steps, gains with friction separated, and the stroke."""
        unloaded, loaded = data.steps
        nominal, is_bounded = scenario.plan.gain, scenario.backend in BODIES
        yield from gain_metrics(nominal, unloaded, loaded, is_bounded)
        yield from separated_metrics(data.separated, data.recordings.gain)
        yield from stroke_metrics(data.recordings, scenario.machine)

    def identified(
        self, scenario: IdentifyActuatorsScenario, data: Identified
    ) -> Mapping[str, Any]:
        """K of each actuator, and the voltages that friction and load take on average."""
        unloaded, loaded = data.separated
        friction = [float(np.mean(v)) for v in (loaded.extending, loaded.retracting)]
        return {
            "control.actuator_gains": [round(gain, 7) for gain in unloaded.gain.tolist()],
            "control.friction_feedforward": [round(max(0.0, v), 4) for v in friction],
        }

    def note(self, scenario: IdentifyActuatorsScenario, data: Identified) -> Iterable[str]:
        """Voltages that friction and load take."""
        return _notes(scenario, data)

    def draw(self, scenario: IdentifyActuatorsScenario, data: Identified) -> Iterable[Figure]:
        """Steps, speeds and gains (Figs. 13 to 15)."""
        return figures(scenario.plan.gain, data.recordings, data.steps)


def check_steps(scenario: IdentifyActuatorsScenario) -> None:
    """Refuse steps that leave the stroke, have no ramp, or leave friction and K together.

    Raises:
        ScenarioError: names the key.
    """
    plan = scenario.plan
    extension = plan.initial_extension
    for i, voltage in enumerate(plan.voltages):
        key = f"steps.voltages.{i}"
        if voltage == 0.0:
            raise ScenarioError(f"{key} = 0 is not a step", key)
        if abs(voltage) > scenario.machine.actuators.supply_voltage:
            supply = scenario.machine.actuators.supply_voltage
            raise ScenarioError(f"{key} = {voltage:g} V is above the supply, {supply:g} V", key)
        lasts = step_duration(plan, voltage)
        if lasts - plan.transient < FEWEST_SAMPLES * plan.period:
            why = f"lasts {lasts:.3g} s, which leaves no ramp after steps.transient_s"
            raise ScenarioError(f"{key} = {voltage:g} V {why}", key)
        is_real = scenario.backend == "hardware"
        extension += plan.gain * voltage * (lasts + plan.edge if is_real else lasts)
        _check_within(key, voltage, extension, scenario.machine.standing_stroke)
        if is_real:
            lifted = extension + (plan.lifted_extension - plan.initial_extension)
            _check_within(key, voltage, lifted, scenario.machine.lifted_stroke)
    # K and friction are separable only if one direction has two voltages.
    if len(set(plan.voltages)) == len(set(np.sign(plan.voltages))):
        why = "has one voltage a direction, which does not tell K from friction"
        raise ScenarioError(f"steps.voltages {why}", "steps.voltages")


def _check_within(key: str, voltage: float, extension: float, stroke: tuple[float, float]) -> None:
    """Refuse a step that leaves a stroke."""
    if not stroke[0] <= extension <= stroke[1]:
        low, high = (1e3 * limit for limit in stroke)
        why = f"would bring the legs to {1e3 * extension:.1f} mm, outside {low:g}..{high:g} mm"
        raise ScenarioError(f"{key} = {voltage:g} V {why}", key)


def record(scenario: IdentifyActuatorsScenario, runner: Runner) -> Recordings:
    """Runs both cases."""
    station = Station(PLATFORM, scenario.levelling)
    context = station.CreateDefaultContext()
    actuators: Any = station.GetSubsystemByName("linear_actuator")
    parameters = actuators.GetMyContextFromRoot(context).get_numeric_parameter(0).CopyToVector()
    gain = parameters / actuators.params.viscous_friction
    unloaded = _unloaded(scenario, runner, actuators, gain)
    return Recordings(unloaded, _loaded(scenario, runner, station), gain)


def _unloaded(
    scenario: IdentifyActuatorsScenario,
    runner: Runner,
    like: LinearActuator,
    gain: NDArray[np.float64],
) -> Recording:
    """Case (a), with actuators like the machine's and of the same gains."""
    builder = DiagramBuilder()
    rods = LinearActuator(
        like.params,
        time_step=like.time_step,
        extension=scenario.plan.initial_extension,
        gain_scale=gain / like.params.gain,
    )
    actuators = add(builder, rods)
    resolution = 1e-3 * scenario.machine.sensors.encoder_resolution_mm
    encoder = add(builder, Encoder(resolution=resolution))
    source = add(builder, TrajectorySource(schedule(scenario.plan)), "voltage")
    connect(builder, source.get_output_port(), actuators.GetInputPort("voltage"))
    connect(builder, actuators.GetOutputPort("extension"), encoder.GetInputPort("position"))
    connect(builder, actuators.GetOutputPort("velocity"), encoder.GetInputPort("velocity"))
    logs = _log(builder, scenario, source, encoder.GetOutputPort("position_measured"))
    simulator = Simulator(builder.Build())
    return _simulate(simulator, scenario, runner, "without load", logs)


def _loaded(
    scenario: IdentifyActuatorsScenario, runner: Runner, station: Station[LevellingScenario]
) -> Recording:
    """Case (b)."""
    builder = DiagramBuilder()
    machine = add(builder, station)
    source = add(builder, TrajectorySource(schedule(scenario.plan)), "voltage")
    connect(builder, source.get_output_port(), machine.GetInputPort("legs.voltage"))
    extension = machine.GetOutputPort("legs.extension")
    logs = _log(builder, scenario, source, extension, machine.GetOutputPort("truth.posture"))
    simulator = make_simulator(builder, station)
    return _simulate(simulator, scenario, runner, "with load", logs)


def _log(
    builder: DiagramBuilder,
    scenario: IdentifyActuatorsScenario,
    source: TrajectorySource,
    *ports: OutputPort,
) -> list[Any]:
    period = scenario.steps.period
    return [LogVectorOutput(p, builder, period) for p in (source.get_output_port(), *ports)]


def _simulate(
    simulator: Simulator,
    scenario: IdentifyActuatorsScenario,
    runner: Runner,
    what: str,
    logs: list[Any],
) -> Recording:
    simulator.Initialize()
    runner.simulate(simulator, schedule(scenario.plan).end_time(), what)
    histories = [log.FindLog(simulator.get_context()) for log in logs]
    voltage, extension, *posture = [log.data().T.copy() for log in histories]
    attitude = posture[0][:, :2] if posture else None
    return Recording(histories[0].sample_times().copy(), voltage, extension, attitude)


def gain_metrics(
    nominal: float, unloaded: Steps, loaded: Steps, is_bounded: bool = True
) -> tuple[Metric, ...]:
    """The paper's K, in which friction and load are contained.

    Args:
        nominal: nominal K [(m/s)/V].
        unloaded: the steps without load.
        loaded: those with load.
        is_bounded: true if single steps are to be as near to the nominal K as in the paper; a real
            machine's actuators are what they are.
    """
    means = [float(case.gain.mean()) for case in (unloaded, loaded)]
    return (
        *(_mean_gain(nominal, case, mean) for case, mean in zip(CASES, means, strict=True)),
        Metric(
            "load_effect_percent",
            100.0 * (means[1] / means[0] - 1.0),
            "%",
            100.0 * SHARE,
            paper="very little",
            meaning="change of K by the load",
        ),
        *(
            Metric(
                f"step_deviation_{case}_percent",
                identified.deviation_percent(nominal),
                "%",
                100.0 * SHARE if is_bounded else None,
                paper=100.0 * SHARE,
                meaning=f"largest deviation of a step's K from {nominal:g}, any leg, {case}",
            )
            for case, identified in zip(CASES, (unloaded, loaded), strict=True)
        ),
        *(
            Metric(
                f"leg_spread_{case}_percent",
                identified.spread_percent,
                "%",
                paper="similar",
                meaning=f"spread of the four legs' mean K, largest less smallest, {case}",
            )
            for case, identified in zip(CASES, (unloaded, loaded), strict=True)
        ),
    )


def separated_metrics(
    cases: tuple[Separated, ...], truth: NDArray[np.float64] | None
) -> tuple[Metric, ...]:
    """K apart from friction, against the truth, or of one case against the other.

    Args:
        cases: without load and with it.
        truth: (4) the actuators' K [(m/s)/V]; None where it is unknown.
    """
    if truth is None:
        unloaded, loaded = (identified.gain for identified in cases)
        meaning = "largest change of a leg's K by the load, with friction separated"
        difference = 100.0 * float(np.abs(loaded / unloaded - 1.0).max())
        return (
            Metric("gain_difference_percent", difference, "%", _DIFFERENCE_BOUND, meaning=meaning),
        )
    return tuple(
        Metric(
            f"gain_error_{case}_percent",
            100.0 * float(np.abs(identified.gain / truth - 1.0).max()),
            "%",
            _SEPARATED_BOUND,
            meaning=f"largest error of K of a leg with friction separated, {case}",
        )
        for case, identified in zip(CASES, cases, strict=True)
    )


def stroke_metrics(recordings: Recordings, machine: PlatformDesign) -> tuple[Metric, ...]:
    """Measure how far legs and platform went.

    Args:
        recordings: recordings of both cases.
        machine: the platform.
    """
    both = [recordings.unloaded.extension, recordings.loaded.extension]
    lifted = []
    if recordings.gain is None:  # a real machine, whose legs are lifted without load
        ends = [1e3 * float(end) for end in (both[0].min(), both[0].max())]
        lowest, highest = (1e3 * limit for limit in machine.lifted_stroke)
        lifted = [
            Metric("smallest_lifted_extension_mm", ends[0], "mm", at_least=lowest),
            Metric("largest_lifted_extension_mm", ends[1], "mm", highest),
        ]
        del both[0]
    low, high = (1e3 * limit for limit in machine.standing_stroke)
    metrics = [
        Metric(
            "smallest_extension_mm",
            1e3 * float(np.min(both)),
            "mm",
            at_least=low,
            meaning="smallest extension of a leg",
        ),
        Metric(
            "largest_extension_mm",
            1e3 * float(np.max(both)),
            "mm",
            high,
            meaning="largest extension of a leg",
        ),
        *lifted,
    ]
    if recordings.loaded.attitude is not None:
        tilt = float(np.degrees(np.abs(recordings.loaded.attitude)).max())
        meaning = "largest roll or pitch of the platform, without a controller"
        metrics.append(Metric("largest_tilt_deg", tilt, "deg", meaning=meaning))
    return tuple(metrics)


def _mean_gain(nominal: float, case: str, mean: float) -> Metric:
    return Metric(
        f"gain_{case}",
        mean,
        "(m/s)/V",
        (1.0 + SHARE) * nominal,
        paper=nominal,
        at_least=(1.0 - SHARE) * nominal,
        meaning=f"actuator gain K of Eq. (17), mean over ten steps and four legs, {case}",
    )


def figures(
    nominal: float, recordings: Recordings, cases: tuple[Steps, ...]
) -> tuple[Figure, ...]:
    """The paper's Figs. 13 to 15.

    Args:
        nominal: nominal K [(m/s)/V].
        recordings: recordings of both cases.
        cases: the steps in them.
    """
    return (
        Figure(
            "fig13_steps_unloaded",
            "Ten voltage steps without load",
            "Above the applied voltage, below the extension by the encoders; the legs are lifted "
            "(Fig. 13).",
            partial(_draw_steps, recordings.unloaded),
            (7.0, 4.2),
        ),
        Figure(
            "fig14_steps_loaded",
            "Ten voltage steps under the platform's weight",
            "Above the applied voltage, below the extension by the encoders; the feet are on the "
            "ground (Fig. 14).",
            partial(_draw_steps, recordings.loaded),
            (7.0, 4.2),
        ),
        Figure(
            "fig15a_speed_over_voltage",
            "Speed of the actuators over voltage",
            f"Slope of each ramp, mean of the four legs, beside K = {nominal:g} (m/s)/V "
            "(Fig. 15a).",
            partial(_draw_speed, nominal, cases),
        ),
        Figure(
            "fig15b_gain_per_step",
            "Gain K of each step",
            f"Mean of the four legs with their range; shaded: {nominal:g} within "
            f"{100 * SHARE:g} % (Fig. 15b).",
            partial(_draw_gain, nominal, cases),
        ),
    )


def _draw_steps(recording: Recording, canvas: "Canvas") -> None:
    upper, lower = canvas.subplots(2, 1, sharex=True)
    upper.step(recording.time, recording.voltage[:, 0], where="post", color="black")
    upper.set_ylabel("voltage [V]")
    for leg in range(LEG_COUNT):
        extension = 1e3 * recording.extension[:, leg]
        width = 2.8 - 0.6 * leg
        lower.plot(recording.time, extension, label=f"leg {leg + 1}", linewidth=width)
    lower.set_ylabel("extension [mm]")
    lower.set_xlabel("time [s]")
    lower.set_xlim(0.0, recording.time[-1])
    canvas.legend(
        *lower.get_legend_handles_labels(),
        loc="outside upper center",
        ncols=LEG_COUNT,
        fontsize=8,
    )


def _draw_speed(nominal: float, cases: tuple[Steps, ...], canvas: "Canvas") -> None:
    axes = canvas.subplots()
    voltage = np.array([cases[0].voltage.min(), cases[0].voltage.max()])
    axes.plot(
        voltage, 1e3 * nominal * voltage, color="0.6", label=f"K = {nominal:g} (m/s)/V", zorder=1
    )
    for case, steps, marker in zip(CASES, cases, _MARKERS, strict=True):
        speed = 1e3 * steps.speed.mean(axis=1)
        axes.scatter(steps.voltage, speed, marker=marker, label=case, zorder=2)
    axes.set_xlabel("voltage [V]")
    axes.set_ylabel("speed [mm/s]")
    axes.legend(loc="upper left", fontsize=8)


def _draw_gain(nominal: float, cases: tuple[Steps, ...], canvas: "Canvas") -> None:
    axes = canvas.subplots()
    axes.axhspan((1.0 - SHARE) * nominal, (1.0 + SHARE) * nominal, color="0.92", zorder=0)
    for case, steps, marker, aside in zip(CASES, cases, _MARKERS, _ASIDE, strict=True):
        gain = steps.gain
        middle = gain.mean(axis=1)
        around = np.array([middle - gain.min(axis=1), gain.max(axis=1) - middle]).clip(min=0.0)
        number = np.arange(1, middle.size + 1) + aside
        axes.errorbar(number, middle, around, marker=marker, ls="", capsize=3, label=case)
    axes.set_xticks(np.arange(1, cases[0].voltage.size + 1))
    axes.set_xlabel("number of the step [-]")
    axes.set_ylabel("K [(m/s)/V]")
    axes.grid(visible=False, axis="x")
    canvas.legend(
        *axes.get_legend_handles_labels(), loc="outside upper center", ncols=2, fontsize=8
    )


def _notes(scenario: IdentifyActuatorsScenario, data: Identified) -> tuple[str, ...]:
    separated = data.separated
    cases_used = [
        f"{np.mean(identified.extending):.3f} V extending and "
        f"{np.mean(identified.retracting):.3f} V retracting {case}"
        for case, identified in zip(CASES, separated, strict=True)
    ]
    gains = ", ".join(f"{gain:.5f}" for gain in separated[0].gain)
    if data.recordings.gain is None:
        last = f"K of legs 1 to 4 with friction separated, without load: {gains} (m/s)/V"
    else:
        last = (
            "Gains are off by up to "
            f"{100 * scenario.machine.actuators.gain_error:g} %, drawn from the seed; "
            "from 4 % on, K of the smallest steps may miss the paper's 15 %, of which friction "
            "and load take most."
        )
    return (
        "K of a step falls short of the true one by friction and load, which take the same "
        "voltage from every step: small steps lose the largest share, and most when they lift "
        f"the platform. Separated from K they are {', '.join(cases_used)}.",
        last,
    )
