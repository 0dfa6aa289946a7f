"""The terrain simulator, with a pedal or a treadmill: one declaration."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram

from parapod.diagrams.machine import Machine, numbered
from parapod.diagrams.plots import Limits
from parapod.diagrams.real import MachineView, RealMachine, SelfTest
from parapod.diagrams.terrain_simulator.controller import make_controller
from parapod.diagrams.terrain_simulator.guard import BenchGuard, BenchLimits
from parapod.diagrams.terrain_simulator.plants import add_bodies, add_kinematics, mirror
from parapod.diagrams.terrain_simulator.ports import PARTS, ports_of_joints
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.diagrams.terrain_simulator.twin import BenchTwin
from parapod.diagrams.wiring import outputs_of, wired
from parapod.systems.terrain_simulator.reference import Task, TerrainReference

# Lag of a drive behind set values, and of its velocity's loop, where devices command it [ms].
_ARRIVAL, _LAG = 10.0, 3.0


def make_terrain(scenario: TerrainBenchScenario, task: Task | None = None) -> Diagram:
    """The source of what the terrain asks, by the machine's names of the signals.

    Args:
        scenario: its walk and `control.period` are taken.
        task: task in the place of the walk.
    """
    walk = scenario.walk if task is None else task
    reference = TerrainReference(walk, scenario.control.period)
    # One of its outputs drives the station itself.
    outputs = {
        "belt.velocity_command" if name == "belt_velocity" else name: name
        for name in outputs_of(reference)
    }
    return wired("terrain", [reference], outputs)


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


_BY_DEVICES = {
    "machine.sliders.encoder_resolution_mm": 0.0,
    "machine.sliders.arrival_ms": _ARRIVAL,
    "machine.sliders.time_constant_ms": _LAG,
}
_MOVE = SelfTest(
    command="position_command",
    usual=0.002,
    largest=0.01,
    measures="position",
    rest={"brake": 0.0},
    is_position=True,
)


def _variant(scenario: TerrainBenchScenario) -> Mapping[str, Any]:
    """Sizes of the ports of the leg, and the drives' limits."""
    machine = scenario.machine
    rail = machine.geometry.slider_min, machine.geometry.slider_max
    ends = {
        "sliders": [[1e3 * end] * 3 for end in rail],
        "hip": [[machine.hip_min_mm], [machine.hip_max_mm]],
    }
    names = "position_min_mm", "position_max_mm"
    real = RealMachine(
        self_tests={"sliders": _MOVE},
        fittings={part: dict(zip(names, both, strict=True)) for part, both in ends.items()},
        exchange={"multibody": 5e-3, "kinematic": 5e-3},
        by_devices=_BY_DEVICES,
        cut={"sliders.brake": 1.0, "hip.brake": 1.0, "hip.force_command": 0.0, "belt.brake": 1.0},
        guard=BenchGuard,
    )
    return {"ports": ports_of_joints(scenario.leg.ports), "real": real}


TERRAIN_BENCH = Machine(
    name="terrain_simulator",
    title="the terrain simulator",
    experiment="bench-walk",
    scenario=TerrainBenchScenario,
    parts=PARTS,
    axes={"sliders": numbered("slider", 3)},
    plants={"multibody": add_bodies, "kinematic": add_kinematics},
    mirror=mirror,
    controller=make_controller,
    sources=lambda scenario: (make_terrain(scenario),),
    view=MachineView(
        BenchTwin,
        plots=(
            "pose_desired[0:2]+pose_estimated[0:2]",
            "pose_desired[2]+pose_estimated[2]",
            "foot_load[0:2]",
            "hip.position",
            "sliders.velocity",
        ),
    ),
    limits=_limits,
    resets=lambda scenario: ("seed",),
    variant=_variant,
    **_variant(TerrainBenchScenario()),
)
