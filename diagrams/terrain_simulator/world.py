"""The same leg in the world: it walks over the terrain itself, and no bench is there.

The hip's slide hangs on a column that goes along with the body, and the terrain stands still. What
the leg does and feels must be what it does and feels on the bench.
"""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from pydrake.geometry import Box, Meshcat
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder, Gain, TrajectorySource, ZeroOrderHold
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.drawing import publish, remove_visuals
from parapod.diagrams.machine import Machine
from parapod.diagrams.multibody import add_plant, lead_joints, moving
from parapod.diagrams.ports import Behind
from parapod.diagrams.terrain_simulator.leg import foot_contact
from parapod.diagrams.terrain_simulator.machine import TERRAIN_BENCH
from parapod.diagrams.terrain_simulator.model import add_leg_on_slide
from parapod.diagrams.terrain_simulator.plants import add_leg_ports, add_plate, simulation_of
from parapod.diagrams.terrain_simulator.ports import PARTS, ports_of_joints
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.diagrams.terrain_simulator.view import profile
from parapod.diagrams.wiring import add, connect
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.walk import BenchWalk

_THICK, _WIDE = 0.1, 0.3  # of the ground's pieces [m]
_BEYOND = 0.5  # ground behind and ahead of the body's way [m]
_GREEN = np.array((0.55, 0.62, 0.50, 1.0))


def walking_in_the_world() -> Machine[TerrainBenchScenario]:
    """The machine with the world in the place of its bench of bodies."""
    return replace(TERRAIN_BENCH, plants={"multibody": add_world})


def add_world(
    builder: DiagramBuilder, scenario: TerrainBenchScenario, meshcat: Meshcat | None
) -> Behind:
    """Adds the leg on its slide, the column that goes along, and the terrain.

    The sliders are at their commands; nothing stands on them.
    """
    walk, step = scenario.walk, scenario.plant.time_step
    plant, scene_graph = add_plant(builder, step, "lagged", scenario.plant.accuracy)
    leg = scenario.leg.under_test
    on_slide = add_leg_on_slide(plant, leg, scenario.hip.mass_kg, scene_graph=scene_graph)
    _lay_out(plant, walk)
    plant.Finalize()
    times = np.arange(-step, walk.duration + scenario.end + 2.0 * step, step)
    motion = walk.at(times)
    x, z = walk.hip
    # A step ahead, as the drive wants it.
    way = (x + motion.distance[0], motion.distance[1])
    travelled = _source(builder, "column", times - step, way, is_state=True)
    if scenario.plant.accuracy is not None:
        held = add(builder, ZeroOrderHold(step, 2), "column_held")
        connect(builder, travelled, held.get_input_port())
        travelled = held.get_output_port()
    reference = moving(builder, plant, travelled, step)
    lead_joints(builder, plant, on_slide.column, reference.now)
    simulation = simulation_of(builder, scenario)
    add_plate(simulation, scenario)
    add_leg_ports(simulation, scenario, plant, on_slide, reference.during)
    simulation.rest(ports_of_joints(scenario.leg.ports), {})  # no force in the cells
    outputs = simulation.outputs
    # Heights over the body's rise, as on the bench.
    for name, order in (("position", 0), ("velocity", 1)):
        pair = (motion.rise[order], motion.rise[order + 1])
        risen = _source(builder, f"rise_{name}", times, pair, is_state=False)
        outputs[f"hip.{name}"] = _less(builder, name, outputs[f"hip.{name}"], risen)
    if meshcat is None:
        remove_visuals(plant, scene_graph)
    else:
        publish(builder, scene_graph, meshcat, "world")
    start = walk.at(0.0)
    stands = leg.all_joints(leg.reach(start.foot[0], float(start.pose[0, 2])))
    positions = np.zeros(plant.num_positions())
    positions[list(on_slide.order(plant))] = (
        x + start.distance[0], z + start.rise[0], *stands
    )  # fmt: skip
    plant.SetDefaultPositions(positions)
    return simulation.behind(PARTS)


def _source(
    builder: DiagramBuilder,
    name: str,
    times: Array,
    motion: tuple[Array, Array],
    *,
    is_state: bool,
) -> OutputPort:
    """Source of values with rates that are known; with `is_state` it shows the rates too."""
    values, rates = (each[np.newaxis] for each in motion)
    hermite: Any = PiecewisePolynomial.CubicHermite
    course = hermite(times, values, rates)
    return add(builder, TrajectorySource(course, int(is_state)), name).get_output_port()


def _less(builder: DiagramBuilder, name: str, whole: OutputPort, part: OutputPort) -> OutputPort:
    """Difference of two numbers."""
    negative = add(builder, Gain(-1.0, 1), f"less_{name}")
    total = add(builder, Adder(2, 1), f"{name}_over_body")
    for source, sink in (
        (part, negative.get_input_port()),
        (whole, total.get_input_port(0)),
        (negative.get_output_port(), total.get_input_port(1)),
    ):
        connect(builder, source, sink)
    return total.get_output_port()


def _lay_out(plant: MultibodyPlant, walk: BenchWalk) -> None:
    """Lays out the terrain under the way of the body, in pieces that are plane."""
    last = float(walk.at(walk.duration).distance[0])
    points = profile(walk.path.terrain, walk.path.start - _BEYOND, last + _BEYOND)
    origin = np.array((walk.path.x_c, 0.0, walk.path.z_c))
    body, properties = plant.world_body(), foot_contact()
    for number, (one, other) in enumerate(pairwise(points)):
        along = other - one
        length, angle = float(np.hypot(*along)), float(np.arctan2(along[1], along[0]))
        rotation = RotationMatrix.MakeYRotation(-angle)
        middle = 0.5 * (one + other)
        below = rotation @ np.array((0.0, 0.0, -0.5 * _THICK))
        place = origin + np.array((middle[0], 0.0, middle[1])) + below
        shape, pose = Box(length, _WIDE, _THICK), RigidTransform(rotation, place)
        plant.RegisterCollisionGeometry(body, pose, shape, f"ground_{number}", properties)
        plant.RegisterVisualGeometry(body, pose, shape, f"ground_{number}", _GREEN)
