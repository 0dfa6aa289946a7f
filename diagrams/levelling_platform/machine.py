"""The levelling platform: one declaration, and its sources of commands."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.levelling_platform.arm_admission import check_swing
from parapod.diagrams.levelling_platform.controller import make_controller
from parapod.diagrams.levelling_platform.disturbances import (
    ACTING,
    check_platform_disturbances,
)
from parapod.diagrams.levelling_platform.mujoco import add_mujoco_plant
from parapod.diagrams.levelling_platform.plants import (
    add_kinematic_plant,
    add_multibody_plant,
    add_simulated,
    mirror,
)
from parapod.diagrams.levelling_platform.ports import PARTS, make_ports
from parapod.diagrams.levelling_platform.real import make_real
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.vibration import shaping_system
from parapod.diagrams.levelling_platform.view import VIEW
from parapod.diagrams.machine import Machine, numbered
from parapod.diagrams.plots import Limits
from parapod.diagrams.wiring import add, connect, named, named_source
from parapod.systems.levelling_platform.geometry import LEG_COUNT
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
    """The trigger of the levelling, and the arm's swing where there is an arm.

    Raises:
        ScenarioError: a swing that the arm's drives cannot follow, or that hits the ground.
    """
    job = scenario.job
    trigger = PiecewisePolynomial.ZeroOrderHold(
        [0.0, job.estimate_at, job.estimate_at + 1e6], [[0.0, 1.0, 1.0]]
    )
    arm = scenario.machine.masses.arm
    sources: list[System] = [named_source("estimate_ground", trigger)]
    if arm.count:
        goal = arm.leaning(math.radians(job.arm.angle_deg))
        keys = "job.arm.angle_deg", "job.arm.duration"
        check_swing(scenario.machine, goal, job.arm.duration, keys)
        start = job.estimate_at + job.arm.start
        swing = swing_to(goal, start, job.arm.duration, start + job.arm.duration + 1e6)
        sources.append(_arm_source(scenario, swing))
    return sources


def _arm_source(scenario: LevellingScenario, way: PiecewisePolynomial) -> System:
    """Source of the arm's commands: a way, shaped if the scenario says so."""
    name, shaper = "arm.position_command", shaping_system(scenario)
    if shaper is None:
        return named_source(name, way)
    builder = DiagramBuilder()
    add(builder, shaper)
    source = add(builder, TrajectorySource(way), "way")
    connect(builder, source.get_output_port(), shaper.get_input_port())
    builder.ExportOutput(shaper.get_output_port(), name)
    return named(name, builder.Build())


def swing_to(
    goal: Sequence[float], start: float, duration: float, end: float
) -> PiecewisePolynomial:
    """Positions (n) of an arm's joints: from zero to a goal along cubics, at rest else.

    Args:
        goal: positions (n) after the swing [rad or m].
        start: beginning of the swing [s].
        duration: its duration [s].
        end: end of the trajectory, after the swing [s].
    """
    knots = [0.0, start, start + duration, end]
    positions = [[0.0, 0.0, position, position] for position in goal]
    return PiecewisePolynomial.CubicHermite(knots, positions, [[0.0] * 4] * len(goal))


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


def _variant(scenario: LevellingScenario) -> Mapping[str, Any]:
    """Parts of a real one, and the size of faults.

    Raises:
        ScenarioError: disturbances that do not fit.
    """
    machine = scenario.machine
    has_arm = machine.masses.arm.count > 0
    check_platform_disturbances(scenario.disturbances, scenario.backend, has_arm)
    ports = make_ports(
        machine.actuators.params,
        machine.level_heights,
        machine.masses.arm,
        machine.wheel_geometry,
    )
    return {"ports": ports, "real": make_real(scenario)}


PLATFORM = Machine(
    name="levelling_platform",
    title="the levelling platform",
    experiment="level",
    scenario=LevellingScenario,
    parts=PARTS,
    axes={"legs": numbered("leg", 4), "wheels": numbered("wheel", 4)},
    plants={
        "multibody": partial(add_simulated, add_multibody_plant),
        "kinematic": partial(add_simulated, add_kinematic_plant),
        "mujoco": partial(add_simulated, add_mujoco_plant),
    },
    disturbances=ACTING,
    feet=LEG_COUNT,
    mirror=mirror,
    controller=make_controller,
    sources=make_sources,
    view=VIEW,
    limits=_limits,
    resets=_resets,
    variant=_variant,
    **_variant(LevellingScenario()),
)
