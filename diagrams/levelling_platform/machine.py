"""The levelling platform: one declaration, and its sources of commands."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray
from pydrake.systems.framework import System
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.levelling_platform.controller import make_controller
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.guard import PlatformGuard
from parapod.diagrams.levelling_platform.homing import make_homing
from parapod.diagrams.levelling_platform.mujoco import add_mujoco_bodies
from parapod.diagrams.levelling_platform.plants import add_bodies, add_mock, add_statics
from parapod.diagrams.levelling_platform.ports import PARTS, make_ports
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.twin import PlatformTwin
from parapod.diagrams.machine import Machine, SelfTest, numbered
from parapod.diagrams.plots import Limits
from parapod.diagrams.wiring import named_source
from parapod.systems.levelling_platform.scripts import PostureScript, Waypoint


def make_sources(scenario: LevellingScenario) -> Sequence[System]:
    """The job of a scenario: postures, the trigger of the levelling, the arm's swing."""
    return (make_script(scenario), *make_job_sources(scenario))


def make_script(scenario: LevellingScenario) -> PostureScript:
    """The postures that a scenario asks for."""
    job = scenario.job
    waypoints = [
        Waypoint(w.time, math.radians(w.roll_deg), math.radians(w.pitch_deg), 1e-3 * w.height_mm)
        for w in job.waypoints
    ]
    return PostureScript(
        scenario.geometry_as_known,
        scenario.level_height,
        waypoints,
        period=scenario.control.period,
    )


def make_job_sources(scenario: LevellingScenario) -> Sequence[System]:
    """The trigger of the levelling and the arm's swing."""
    job = scenario.job
    trigger = PiecewisePolynomial.ZeroOrderHold(
        [0.0, job.estimate_at, job.estimate_at + 1e6], [[0.0, 1.0, 1.0]]
    )
    start = job.estimate_at + job.arm.start
    angle = math.radians(job.arm.angle_deg)
    # At rest before and after the swing; a cubic in between.
    knots = [0.0, start, start + job.arm.duration, start + job.arm.duration + 1e6]
    arm = PiecewisePolynomial.CubicHermite(knots, [[0.0, 0.0, angle, angle]], [[0.0] * 4])
    return (
        named_source("estimate_ground", trigger),
        named_source("arm.position_command", arm),
    )


def _emulated(scenario: LevellingScenario, period: float) -> LevellingScenario:
    """Everything that is sampled has the exchange's period [s]."""
    return replace(scenario, control=replace(scenario.control, period=period))


def _resets(scenario: LevellingScenario) -> tuple[str, ...]:
    """Keys of a beginning; dimensions as built, which the seed decides too, are not part of it."""
    plant = scenario.plant
    is_as_drawn = plant.length_error_mm == plant.angle_error_deg == 0.0
    # Bodies stand on pads, which are built in.
    uneven = ("ground.foot_heights_mm",) if scenario.backend == "kinematic" else ()
    return (
        *(("seed",) if is_as_drawn else ()),
        *("ground.roll_deg", "ground.pitch_deg", *uneven),
        "machine.actuators.gain_error",
        "machine.sensors.accel_bias_mg",
        "machine.sensors.gyro_bias_deg_s",
        "job.initial_extension_mm",
    )


def _limits(scenario: LevellingScenario) -> Limits:
    """Supply of the motors and stroke of the rods, as they are in a scenario."""
    actuators = scenario.machine.actuators
    supply, rods = actuators.supply_voltage, actuators.params
    return {
        "legs.voltage": (-supply, supply),
        "truth.extension": (rods.stop_min, rods.stop_max),
    }


# Voltages of a self-test by the supply's: usual and largest [-].
_USUAL, _LARGEST = 1.0 / 12.0, 1.0 / 6.0
# Resolution of the optical tracker of Appendix B [mm, deg].
_TRACKER = (0.05, 0.01)


def _instrument(signals: Mapping[str, NDArray[Any]]) -> str:
    """The posture as the optical tracker of Appendix B tells it."""
    roll, pitch, height = signals["truth.posture"].tolist()
    length, angle = _TRACKER
    reading = [length * round(1e3 * height / length)]
    reading += [angle * round(math.degrees(x) / angle) for x in (roll, pitch)]
    return f"height {reading[0]:.2f} mm, roll {reading[1]:.2f} deg, pitch {reading[2]:.2f} deg"


def _variant(scenario: LevellingScenario) -> Mapping[str, Any]:
    """The self-test and the homing by the actuators, and the size of faults."""
    machine = scenario.machine
    params = machine.actuators.params
    usual, largest = (share * params.supply_voltage for share in (_USUAL, _LARGEST))
    legs = SelfTest(
        command="voltage",
        usual=usual,
        largest=largest,
        measures="extension",
        gain=params.gain,
        rest={"stop": 0.0},
    )
    wheels = SelfTest(
        command="velocity_command",
        usual=1.0,
        largest=2.0,
        measures="position",
        rest={"brake": 0.0},
    )
    return {
        "self_tests": {"legs": legs, "wheels": wheels},
        "homings": {"legs": make_homing(machine)},
        "fittings": {"legs": _switches(machine)},
        "ports": make_ports(params, machine.level_heights),
    }


def _switches(machine: PlatformDesign) -> Mapping[str, Any]:
    """Places of the end switches, to a micrometre [mm]."""
    switches = machine.actuators.switches
    ends = {"extended_mm": switches.extended, "retracted_mm": switches.retracted}
    return {name: round(1e3 * end, 3) for name, end in ends.items()}


PLATFORM = Machine(
    name="levelling_platform",
    title="the levelling platform",
    experiment="level",
    scenario=LevellingScenario,
    parts=PARTS,
    axes={"legs": numbered("leg", 4), "wheels": numbered("wheel", 4)},
    plants={"multibody": add_bodies, "kinematic": add_statics, "mujoco": add_mujoco_bodies},
    mock=add_mock,
    controller=make_controller,
    sources=make_sources,
    emulated=_emulated,
    cut={
        "legs.voltage": 0.0,
        "legs.stop": 1.0,
        "wheels.velocity_command": 0.0,
        "wheels.brake": 1.0,
    },
    drives=("legs.voltage",),
    switches=("legs.limits",),
    guard=PlatformGuard,
    instrument=_instrument,
    twin=PlatformTwin,
    limits=_limits,
    plots=(
        "posture_desired_state[0]+attitude_estimated[0]+truth.posture[0]",
        "posture_desired_state[1]+attitude_estimated[1]+truth.posture[1]",
        "posture_desired_state[2]+truth.posture[2]",
        "legs.extension",
        "legs.voltage",
    ),
    variant=_variant,
    exchange={"multibody": 2e-3, "kinematic": 2e-3, "mujoco": 2e-3},
    resets=_resets,
    **_variant(LevellingScenario()),
)
