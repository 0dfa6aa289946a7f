"""The terrain simulator, with a pedal or a treadmill: one declaration."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram

from parapod.diagrams.machine import Machine, numbered
from parapod.diagrams.plots import Limits
from parapod.diagrams.terrain_simulator.controller import make_controller
from parapod.diagrams.terrain_simulator.plants import add_bodies, add_kinematics, mirror
from parapod.diagrams.terrain_simulator.ports import PARTS, ports_of_joints
from parapod.diagrams.terrain_simulator.real import BenchLimits, make_real
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.diagrams.terrain_simulator.view import VIEW
from parapod.diagrams.wiring import outputs_of, wired
from parapod.systems.terrain_simulator.reference import Task, TerrainReference


def make_terrain(scenario: TerrainBenchScenario, task: Task | None = None) -> Diagram:
    """The source of what the terrain asks, by the machine's names of the signals.

    Args:
        scenario: its walk and `control.period` are taken.
        task: task in the place of the walk.
    """
    walk = scenario.walk if task is None else task
    reference = TerrainReference(walk, scenario.control.period)
    # One of its outputs drives the station itself.
    names = {"belt_velocity": "belt.velocity_command"}
    outputs = [names.get(name, name) for name in outputs_of(reference)]
    return wired("terrain", [reference], outputs, names)


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


def _variant(scenario: TerrainBenchScenario) -> Mapping[str, Any]:
    """Sizes of the ports of the leg, and what a real bench needs."""
    return {"ports": ports_of_joints(scenario.leg.ports), "real": make_real(scenario)}


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
    view=VIEW,
    limits=_limits,
    resets=lambda scenario: ("seed",),
    variant=_variant,
    **_variant(TerrainBenchScenario()),
)
