"""Terrains that the bench's legs walk over, each with a gait for it."""

from typing import NamedTuple

from parapod.diagrams.terrain_simulator.design import BenchDesign
from parapod.diagrams.terrain_simulator.scenario import (
    GaitScenario,
    HipScenario,
    LegScenario,
    PlaceScenario,
    TerrainBenchScenario,
)
from parapod.diagrams.terrain_simulator.terrains import (
    AlternatingSlopes,
    Level,
    Slope,
    Stairs,
    Step,
    TerrainChoice,
)
from parapod.systems.core.errors import ScenarioError


class Course(NamedTuple):
    """A terrain and a gait for it.

    Attributes:
        terrain: the terrain.
        speed: speed of the body [m/s].
        frequency: strides a second [Hz].
        place: x of the plate's middle, and its height [mm].
        hip: height of the hip above it [mm].
        clearance: height of the foot above its footholds in the middle of a swing [mm].
        start: way of the body at the beginning [m].
    """

    terrain: TerrainChoice
    speed: float
    frequency: float
    place: tuple[float, float]
    hip: float = 580.0
    clearance: float = 60.0
    start: float = 0.0


# Terrains that the pedal can play, each in its place; their edges are where no foot treads.
COURSES = {
    "level": Course(Level(), 0.8, 2.0, (513.0, 300.0)),
    "slope up 20": Course(Slope(20.0), 0.8, 2.0, (562.0, 260.0)),
    "slope down 20": Course(Slope(-20.0), 0.8, 2.0, (474.0, 260.0)),
    "slope up 30": Course(Slope(30.0), 0.8, 2.0, (582.0, 240.0)),
    "slope down 30": Course(Slope(-30.0), 0.8, 2.0, (458.0, 240.0)),
    "stairs up": Course(Stairs(170.0, 290.0, 0.19), 0.435, 1.5, (561.0, 250.0), 560.0, 140.0),
    "stairs down": Course(Stairs(-150.0, 300.0, 0.15), 0.45, 1.5, (481.0, 250.0), 560.0, 130.0),
    "step up": Course(Step(120.0, 0.6), 0.6, 1.5, (549.0, 250.0), 560.0, 140.0),
    "step down": Course(Step(-120.0, 0.6), 0.6, 1.5, (489.0, 250.0), 560.0, 60.0),
    "alternating slopes": Course(
        AlternatingSlopes(20.0, 1.1), 0.8, 2.0, (513.0, 270.0), clearance=110.0, start=0.15
    ),
}


def place_on(machine: BenchDesign, x_mm: float, z_mm: float) -> tuple[float, float]:
    """Place on a bench [mm] like a place on the paper's bench with a pedal.

    Args:
        machine: the bench.
        x_mm: place of the plate's middle along the paper's rail [mm].
        z_mm: height of it there [mm].

    Raises:
        ScenarioError: the level plate of the bench reaches nothing at that height.
    """
    paper = BenchDesign()
    scale = machine.geometry.link / paper.geometry.link
    height = 1e-3 * z_mm * scale
    (own, _), (usual, _) = machine.place(height), paper.place(1e-3 * z_mm)
    return x_mm * scale + 1e3 * (own - usual * scale), z_mm * scale


def scenario_of(
    name: str, leg: LegScenario, mass_kg: float, machine: BenchDesign
) -> TerrainBenchScenario:
    """The walk of a leg over one terrain of the course.

    Args:
        name: name of the terrain.
        leg: the leg.
        mass_kg: mass that the slide has with it [kg].
        machine: the bench.

    Raises:
        ScenarioError: an unknown terrain.
    """
    if name not in COURSES:
        names = ", ".join(COURSES)
        raise ScenarioError(f"courses: there is no '{name}'; there are: {names}", "courses")
    course = COURSES[name]
    return TerrainBenchScenario(
        machine=machine,
        terrain=course.terrain,
        leg=leg,
        hip=HipScenario(mass_kg=mass_kg),
        place=PlaceScenario(*place_on(machine, *course.place), course.hip, course.start),
        gait=GaitScenario(
            speed_m_s=course.speed,
            frequency_Hz=course.frequency,
            ramp=None,
            clearance_mm=course.clearance,
        ),
    )
