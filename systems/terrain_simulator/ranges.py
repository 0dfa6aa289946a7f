"""Ranges of the terrain simulator in closed form: slopes, steps and speeds of a leg's walk."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from parapod.systems.core.batching import of_width
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import jacobian
from parapod.systems.terrain_simulator.load_estimator import (
    BenchMasses,
    PlaneBody,
    drive_forces,
)
from parapod.systems.terrain_simulator.path import PathLimits, PlatePath, first_broken
from parapod.systems.terrain_simulator.terrain import Slope, Step, Terrain

# Instants of a stride that are looked at, and strides over a step.
_INSTANTS, _STRIDES = 120, 8
_HALVINGS = 22
_STEEPEST = math.radians(60.0)
# Highest step and fastest walk that are looked at, by a link's length [-], [1/s].
_HIGHEST, _FASTEST = 2.0, 100.0


def keeps_limits(
    geometry: BenchGeometry, path: PlatePath, limits: PathLimits, strides: float = 1.0
) -> bool:
    """True if the bench keeps all limits on strides of a path.

    Args:
        geometry: the bench.
        path: the path.
        limits: limits of the path.
        strides: number of strides from the path's beginning on.
    """
    count = math.ceil(strides * _INSTANTS)
    times = np.linspace(0.0, strides / path.gait.frequency, count + 1)
    motion = path.at(times)
    belt = path.gait.stance / np.cos(motion.pose[..., 2]) if path.treadmill else None
    poses = np.stack((motion.pose, motion.velocity, motion.acceleration))
    return first_broken(geometry, times, poses, limits, belt) is None


def largest_slope(
    geometry: BenchGeometry, path: PlatePath, limits: PathLimits, way: float
) -> float:
    """Largest slope that the path walks, up (way 1) or down (way -1) [rad]; 0 if none is."""

    def passes(angle: float) -> bool:
        slope = replace(path, terrain=Slope(way * angle), start=0.0)
        return keeps_limits(geometry, slope, limits)

    return _largest(passes, _STEEPEST)


def largest_step(
    geometry: BenchGeometry, path: PlatePath, limits: PathLimits, way: float
) -> float:
    """Highest step that the path walks, up (way 1) or down (way -1) [m]; 0 if none is.

    Its edge is in the middle between two footholds.
    """
    edge = float(path.footholds(np.array(0.5 * _STRIDES)) - 0.5 * path.gait.stride)

    def passes(rise: float) -> bool:
        terrain: Terrain = Step(way * rise, edge)
        return keeps_limits(geometry, replace(path, terrain=terrain), limits, _STRIDES)

    return _largest(passes, _HIGHEST * geometry.link)


def largest_speed(geometry: BenchGeometry, path: PlatePath, limits: PathLimits) -> float:
    """Largest speed of the body at the path's frequency of strides [m/s]; 0 if none is."""
    return _largest(
        lambda speed: keeps_limits(geometry, path.at_speed(speed), limits),
        _FASTEST * geometry.link,
    )


def _largest(passes: Callable[[float], bool], most: float) -> float:
    """Largest number below the first one that does not pass, by halves; 0 if none does."""
    low, high = 0.0, most
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if passes(middle) else (low, middle)
    return low


def holding_forces(
    geometry: BenchGeometry, bodies: BenchMasses, pose: ArrayLike, load: ArrayLike
) -> Array:
    """Forces (..., 3) of the sliders' drives that hold the bench and a load at rest [N].

    Args:
        geometry: the bench.
        bodies: its masses.
        pose: (..., 3) x, z, phi [m, m, rad].
        load: (..., 3) F_x, F_z, M_y on the plate at its middle [N, N, N m].
    """
    poses = of_width(pose, 3, "pose")
    motion = np.concatenate((poses, np.zeros((*poses.shape[:-1], 6))), axis=-1)
    return drive_forces(geometry, bodies, motion, load)


def scaled_jacobian(geometry: BenchGeometry, pose: Array) -> Array:
    """Motion (..., 3, 3) of the plate by the sliders, turns as ways of T about P [-].

    Args:
        geometry: the bench.
        pose: (..., 3) x, z, phi [m, m, rad].
    """
    return jacobian(geometry, pose) * np.array((1.0, 1.0, geometry.lever))[:, np.newaxis]


def centre_height(geometry: BenchGeometry, masses: BenchMasses, z: float) -> float:
    """Height of the centre of mass of what moves above the rail, the plate level [m].

    Args:
        geometry: the bench.
        masses: its masses.
        z: height of the plate's middle [m].
    """

    def bar(body: PlaneBody, length: float, height: float) -> float:
        aside = math.sqrt(max(0.0, length**2 - height**2))
        along, across = (each / length for each in body.centre)
        return body.mass * (along * height + across * aside)

    link, strut, plate = masses.link, masses.strut, masses.plate
    z_P, z_T = z + geometry.p_OP[1], z + geometry.p_OT[1]
    moment = plate.mass * (z + plate.centre[1])
    moment += 2.0 * bar(link, geometry.link, z_P) + bar(strut, geometry.strut, z_T)
    return moment / moving_mass(masses)


def moving_mass(masses: BenchMasses) -> float:
    """Mass of sliders, links, strut and plate [kg]."""
    bars = 2.0 * masses.link.mass + masses.strut.mass
    return 3.0 * masses.slider + bars + masses.plate.mass
