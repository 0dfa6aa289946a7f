"""The voltage steps without and with load, simulated with the same actuators."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource

from parapod.diagrams.levelling_platform.station import Station, make_station
from parapod.diagrams.wiring import add, connect
from parapod.sims.driven_machine import make_simulator
from parapod.sims.experiment import RunOptions
from parapod.sims.experiment_log import write_experiment_log
from parapod.sims.identify_actuators_scenario import IdentifyActuatorsScenario, schedule
from parapod.sims.simulate import simulate
from parapod.systems.actuators.linear_actuator import LinearActuator
from parapod.systems.sensors.encoder import Encoder

CASES = ("unloaded", "loaded")


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
class Recordings:
    """Both cases.

    Attributes:
        unloaded: (a), the legs are lifted, so that nothing loads the actuators.
        loaded: (b), the platform stands on its legs.
        gain: (4) true K of the actuators in both, which no log tells [(m/s)/V].
    """

    unloaded: Recording
    loaded: Recording
    gain: NDArray[np.float64]


def record(scenario: IdentifyActuatorsScenario, options: RunOptions) -> Recordings:
    """Runs both cases."""
    station = make_station(scenario.machine)
    context = station.diagram.CreateDefaultContext()
    station.reset(context)
    actuators: Any = station.diagram.GetSubsystemByName("linear_actuator")
    drawn = actuators.GetMyContextFromRoot(context).get_numeric_parameter(0).CopyToVector()
    gain = drawn / actuators.params.viscous_friction
    unloaded = _unloaded(scenario, options, actuators, gain)
    return Recordings(unloaded, _loaded(scenario, options, station), gain)


def write_recordings(
    scenario: IdentifyActuatorsScenario, options: RunOptions, recordings: Recordings
) -> None:
    """Writes the log, if one is asked for; both cases have the same times.

    Raises:
        OutputError: the file cannot be written.
    """
    if options.log is None:
        return
    signals = {}
    for case in CASES:
        recording: Recording = getattr(recordings, case)
        signals[f"{case}.legs.voltage"] = (recording.voltage, "V")
        signals[f"{case}.legs.extension"] = (recording.extension, "m")
    time = recordings.loaded.time
    write_experiment_log(options.log, "identify-actuators", scenario, time, signals)


def _unloaded(
    scenario: IdentifyActuatorsScenario,
    options: RunOptions,
    like: LinearActuator,
    gain: NDArray[np.float64],
) -> Recording:
    """Case (a), with actuators like the machine's and of the same gains."""
    builder = DiagramBuilder()
    actuators = add(builder, LinearActuator(like.params, time_step=like.time_step))
    encoder = add(builder, Encoder(resolution=1e-3 * scenario.encoder_resolution_mm))
    source = add(builder, TrajectorySource(schedule(scenario.steps)), "voltage")
    connect(builder, source.get_output_port(), actuators.GetInputPort("voltage"))
    connect(builder, actuators.GetOutputPort("extension"), encoder.GetInputPort("position"))
    connect(builder, actuators.GetOutputPort("velocity"), encoder.GetInputPort("velocity"))
    logs = _log(builder, scenario, source, encoder.GetOutputPort("position_measured"))
    simulator = Simulator(builder.Build())
    context = actuators.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    actuators.set_extension(context, 1e-3 * scenario.steps.initial_extension_mm)
    actuators.set_gain_scale(context, gain / like.params.gain)
    return _simulate(simulator, scenario, options, "without load", logs)


def _loaded(
    scenario: IdentifyActuatorsScenario, options: RunOptions, station: Station
) -> Recording:
    """Case (b)."""
    builder = DiagramBuilder()
    machine = add(builder, station.diagram)
    source = add(builder, TrajectorySource(schedule(scenario.steps)), "voltage")
    connect(builder, source.get_output_port(), machine.GetInputPort("legs.voltage"))
    extension = machine.GetOutputPort("legs.extension")
    logs = _log(builder, scenario, source, extension, machine.GetOutputPort("truth.posture"))
    simulator = make_simulator(builder, station)
    return _simulate(simulator, scenario, options, "with load", logs)


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
    options: RunOptions,
    what: str,
    logs: list[Any],
) -> Recording:
    simulator.Initialize()
    simulate(simulator, schedule(scenario.steps).end_time(), options.console, what)
    found = [log.FindLog(simulator.get_context()) for log in logs]
    samples = [log.data().T.copy() for log in found]
    return Recording(found[0].sample_times().copy(), *samples)
