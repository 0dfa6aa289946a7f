"""The terrain simulator, with a pedal or a treadmill: one declaration."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from parapod.diagrams.machine import Machine, SelfTest, numbered
from parapod.diagrams.plots import Limits
from parapod.diagrams.terrain_simulator.controller import make_controller
from parapod.diagrams.terrain_simulator.guard import BenchGuard, BenchLimits
from parapod.diagrams.terrain_simulator.plants import add_bodies, add_kinematics, add_mock
from parapod.diagrams.terrain_simulator.ports import PARTS, ports_of_joints
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.diagrams.terrain_simulator.twin import BenchTwin
from parapod.diagrams.wiring import add, outputs_of
from parapod.systems.terrain_simulator.reference import Task, TerrainReference

# Lag of a drive behind set values, and of its velocity's loop, where devices command it [ms].
_ARRIVAL, _LAG = 10.0, 3.0
# Outputs of the reference that drive the station itself, by the station's names.
_DRIVEN = {"belt_velocity": "belt.velocity_command"}


def make_terrain(scenario: TerrainBenchScenario, task: Task | None = None) -> Diagram:
    """The source of what the terrain asks, by the machine's names of the signals.

    Args:
        scenario: its walk and `control.period` are taken.
        task: task in the place of the walk.
    """
    builder = DiagramBuilder()
    walk = scenario.walk if task is None else task
    reference = add(builder, TerrainReference(walk, scenario.control.period))
    for name, port in outputs_of(reference).items():
        builder.ExportOutput(port, _DRIVEN.get(name, name))
    diagram = builder.Build()
    diagram.set_name("terrain")
    return diagram


def _sources(scenario: TerrainBenchScenario) -> Sequence[System]:
    return (make_terrain(scenario),)


def _variant(scenario: TerrainBenchScenario) -> Mapping[str, Any]:
    """Sizes of the ports of the leg, and the drives' limits."""
    machine = scenario.machine
    rail = machine.geometry.slider_min, machine.geometry.slider_max
    ends = {
        "sliders": [[1e3 * end] * 3 for end in rail],
        "hip": [[machine.hip_min_mm], [machine.hip_max_mm]],
    }
    names = "position_min_mm", "position_max_mm"
    return {
        "ports": ports_of_joints(scenario.leg.ports),
        "fittings": {part: dict(zip(names, both, strict=True)) for part, both in ends.items()},
    }


def _limits(scenario: TerrainBenchScenario) -> Limits:
    """Rail, speed and force of the sliders, the hip's slide and drive, force cells and leg."""
    geometry, sliders = scenario.machine.geometry, scenario.machine.sliders
    usual = BenchLimits.for_machine(scenario.machine)
    rail = geometry.slider_min, geometry.slider_max
    speed, force, support = sliders.max_velocity_m_s, sliders.max_force_N, scenario.hip.max_force_N
    current = force / sliders.force_per_current_N_A
    torque = np.array(scenario.leg.under_test.max_torque)
    return {
        **dict.fromkeys(("sliders.position", "sliders.position_command"), rail),
        "sliders.velocity": (-speed, speed),
        "sliders.current": (-current, current),
        "truth.slider_force": (-force, force),
        "hip.position": (usual.lowest, None),
        "hip.force_command": (-support, support),
        "cells.force": (-usual.crushed, usual.crushed),
        "leg.torque_command": (-torque, torque),
    }


def _emulated(scenario: TerrainBenchScenario, period: float) -> TerrainBenchScenario:
    """Drives as devices command them: these count, and their set values come when they come."""
    machine = scenario.machine
    sliders = replace(
        machine.sliders, encoder_resolution_mm=0.0, arrival_ms=_ARRIVAL, time_constant_ms=_LAG
    )
    return replace(
        scenario,
        control=replace(scenario.control, period=period),
        machine=replace(machine, sliders=sliders),
    )


_MOVE = SelfTest(
    command="position_command",
    usual=0.002,
    largest=0.01,
    measures="position",
    rest={"brake": 0.0},
    is_position=True,
)

TERRAIN_BENCH = Machine(
    name="terrain_simulator",
    title="the terrain simulator",
    experiment="bench-walk",
    scenario=TerrainBenchScenario,
    ports=ports_of_joints(TerrainBenchScenario().leg.ports),
    parts=PARTS,
    axes={"sliders": numbered("slider", 3)},
    plants={"multibody": add_bodies, "kinematic": add_kinematics},
    mock=add_mock,
    controller=make_controller,
    sources=_sources,
    self_tests={"sliders": _MOVE},
    emulated=_emulated,
    cut={"sliders.brake": 1.0, "hip.brake": 1.0, "hip.force_command": 0.0, "belt.brake": 1.0},
    guard=BenchGuard,
    twin=BenchTwin,
    limits=_limits,
    plots=(
        "pose_desired[0:2]+pose_estimated[0:2]",
        "pose_desired[2]+pose_estimated[2]",
        "foot_load[0:2]",
        "hip.position",
        "sliders.velocity",
    ),
    variant=_variant,
    exchange={"multibody": 5e-3, "kinematic": 5e-3},
    resets=lambda scenario: ("seed",),
)
