"""Leg-supported parallel machines as Drake system diagrams: the names for scripts and notebooks.

    import parapod

    scenario = parapod.scenario("level", seed=3)  # settings, checked whenever they change
    scenario.ground.pitch_deg = 4.0
    loop = parapod.closed_loop(scenario)  # a Diagram
    simulator = loop.simulator()  # Drake's Simulator
    simulator.AdvanceTo(10.0)
    recording = loop.recording(simulator.get_context())  # signals by port name, with units
    recording.plot("truth.posture", "posture_desired_state")
    parapod.run("level", seed=3, backend="kinematic")  # metrics, bounds and figures
    parapod.study("level", {"seed": "0:20", "ground.pitch_deg": "-5:5:11"})  # on all cores
    parapod.rows(loop, scenarios)  # many loops of one structure, simulated side by side
    parapod.draw(loop)  # the diagram as a picture
    parapod.Scene.from_meshcat(meshcat)  # drawn by `closed_loop(scenario, meshcat=meshcat)`
    parapod.linearised(system, context, ["u"], ["y"])  # A, B, C, D, where it has them
    parapod.Mechanism.load("robot.urdf")  # any closed-loop mechanism, posed numerically
    parapod.Alone(system, {"voltage": 3.0})  # one component in a diagram that can be simulated
    parapod.IoThread(read=bus.read, size=3)  # calls that block, in a thread beside a loop

`parapod list` names the experiments, `parapod.experiments()` too. A package with a machine or an
experiment of its own finds what it needs here as well (`Machine`, `In`, `Out`, `Experiment`, ...).
Everything is loaded when it is first used.
"""

import importlib
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from parapod.diagrams.alone import Alone
    from parapod.diagrams.block_diagram import BlockDiagram, draw
    from parapod.diagrams.closed_loop import ClosedLoop
    from parapod.diagrams.faults import FaultScenario
    from parapod.diagrams.homing import Homing
    from parapod.diagrams.io_thread import IoThread
    from parapod.diagrams.linear import linearised
    from parapod.diagrams.machine import (
        ControlScenario,
        Machine,
        MachineScenario,
        find_machine,
    )
    from parapod.diagrams.ports import Behind, In, Inner, Out, Span, Truth
    from parapod.diagrams.real import MachineView, RealMachine, SelfTest
    from parapod.diagrams.recording import Recording
    from parapod.diagrams.side_by_side import LoopRows
    from parapod.diagrams.station import Station
    from parapod.diagrams.wiring import (
        add,
        connect,
        inputs_of,
        named_source,
        outputs_of,
        wired,
    )
    from parapod.sims.api import (
        closed_loop,
        experiments,
        rows,
        run,
        scenario,
        study,
        viewer,
    )
    from parapod.sims.lab.experiment import Experiment, LoopExperiment
    from parapod.sims.lab.scene import Scene
    from parapod.sims.output.drawn import LogDrawing
    from parapod.sims.output.figures import Figure
    from parapod.sims.output.options import RunOptions
    from parapod.sims.output.results import Metric, Result
    from parapod.sims.real_machine.own_emulator import own_emulator
    from parapod.sims.study.result import StudyResult, read_study
    from parapod.systems.actuators.compound_position_controller import (
        CompoundPositionController,
        CompoundPositionControllerParams,
    )
    from parapod.systems.actuators.linear_actuator import LinearActuator, LinearActuatorParams
    from parapod.systems.actuators.pi_controller import PiController, PiControllerParams
    from parapod.systems.actuators.position_servo import PositionServo
    from parapod.systems.actuators.velocity_servo import VelocityServo, VelocityServoParams
    from parapod.systems.core.errors import ParapodError, ScenarioError, UnreachablePosture
    from parapod.systems.core.function import FunctionSystem
    from parapod.systems.core.leaf_system import LeafSystem
    from parapod.systems.core.ports import read, read_array, read_or_zeros
    from parapod.systems.core.schema import Schema, choice, quantity
    from parapod.systems.mechanism.equations import UnsolvedPose
    from parapod.systems.mechanism.leaf_systems import (
        MechanismForces,
        MechanismForward,
        MechanismInverse,
    )
    from parapod.systems.mechanism.mechanism import Mechanism
    from parapod.systems.mechanism.statics import motor_forces
    from parapod.systems.sensors.attitude_estimator import (
        AttitudeEstimator,
        AttitudeEstimatorParams,
    )

_HOMES = {
    "diagrams.alone": ("Alone",),
    "diagrams.block_diagram": ("BlockDiagram", "draw"),
    "diagrams.closed_loop": ("ClosedLoop",),
    "diagrams.faults": ("FaultScenario",),
    "diagrams.homing": ("Homing",),
    "diagrams.io_thread": ("IoThread",),
    "diagrams.linear": ("linearised",),
    "diagrams.machine": (
        "ControlScenario",
        "Machine",
        "MachineScenario",
        "find_machine",
    ),
    "diagrams.ports": ("Behind", "In", "Inner", "Out", "Span", "Truth"),
    "diagrams.real": ("MachineView", "RealMachine", "SelfTest"),
    "diagrams.recording": ("Recording",),
    "diagrams.side_by_side": ("LoopRows",),
    "diagrams.station": ("Station",),
    "diagrams.wiring": (
        "add",
        "connect",
        "inputs_of",
        "motor_forces",
        "named_source",
        "outputs_of",
        "wired",
    ),
    "sims.api": ("closed_loop", "experiments", "rows", "run", "scenario", "study", "viewer"),
    "sims.output.drawn": ("LogDrawing",),
    "sims.lab.experiment": ("Experiment", "LoopExperiment"),
    "sims.output.figures": ("Figure",),
    "sims.output.results": ("Metric", "Result"),
    "sims.output.options": ("RunOptions",),
    "sims.lab.scene": ("Scene",),
    "sims.real_machine.own_emulator": ("own_emulator",),
    "sims.study.result": ("StudyResult", "read_study"),
    "systems.actuators.compound_position_controller": (
        "CompoundPositionController",
        "CompoundPositionControllerParams",
    ),
    "systems.actuators.linear_actuator": (
        "LinearActuator",
        "LinearActuatorParams",
    ),
    "systems.actuators.pi_controller": (
        "PiController",
        "PiControllerParams",
    ),
    "systems.actuators.position_servo": ("PositionServo",),
    "systems.actuators.velocity_servo": (
        "VelocityServo",
        "VelocityServoParams",
    ),
    "systems.core.errors": ("ParapodError", "ScenarioError", "UnreachablePosture"),
    "systems.core.function": ("FunctionSystem",),
    "systems.core.leaf_system": ("LeafSystem",),
    "systems.core.ports": ("read", "read_array", "read_or_zeros"),
    "systems.core.schema": ("Schema", "choice", "quantity"),
    "systems.mechanism.leaf_systems": (
        "MechanismForces",
        "MechanismForward",
        "MechanismInverse",
    ),
    "systems.mechanism.equations": ("UnsolvedPose",),
    "systems.mechanism.mechanism": ("Mechanism",),
    "systems.mechanism.statics": ("motor_forces",),
    "systems.sensors.attitude_estimator": (
        "AttitudeEstimator",
        "AttitudeEstimatorParams",
    ),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__version__ = version("parapod")
__all__ = [
    "Alone",
    "AttitudeEstimator",
    "AttitudeEstimatorParams",
    "Behind",
    "BlockDiagram",
    "ClosedLoop",
    "CompoundPositionController",
    "CompoundPositionControllerParams",
    "ControlScenario",
    "Experiment",
    "FaultScenario",
    "Figure",
    "FunctionSystem",
    "Homing",
    "In",
    "Inner",
    "IoThread",
    "LeafSystem",
    "LinearActuator",
    "LinearActuatorParams",
    "LogDrawing",
    "LoopExperiment",
    "LoopRows",
    "Machine",
    "MachineScenario",
    "MachineView",
    "Mechanism",
    "MechanismForces",
    "MechanismForward",
    "MechanismInverse",
    "Metric",
    "Out",
    "ParapodError",
    "PiController",
    "PiControllerParams",
    "PositionServo",
    "RealMachine",
    "Recording",
    "Result",
    "RunOptions",
    "ScenarioError",
    "Scene",
    "Schema",
    "SelfTest",
    "Span",
    "Station",
    "StudyResult",
    "Truth",
    "UnreachablePosture",
    "UnsolvedPose",
    "VelocityServo",
    "VelocityServoParams",
    "add",
    "choice",
    "closed_loop",
    "connect",
    "draw",
    "experiments",
    "find_machine",
    "inputs_of",
    "linearised",
    "motor_forces",
    "named_source",
    "outputs_of",
    "own_emulator",
    "quantity",
    "read",
    "read_array",
    "read_or_zeros",
    "read_study",
    "rows",
    "run",
    "scenario",
    "study",
    "viewer",
    "wired",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'parapod' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"parapod.{_HOME_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
