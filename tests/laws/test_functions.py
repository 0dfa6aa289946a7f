"""Laws of every public function of `parapod.systems` whose text tells of batches, `(..., n)`."""

import importlib
import inspect
import pkgutil

import numpy as np
import pytest

import parapod.systems
from parapod.systems.core.errors import ParapodError
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.statics import KinematicPlatformParams
from parapod.systems.levelling_platform.workspace import ArmGeometry, Workspace
from parapod.systems.levelling_platform.zero_moment_point import ArmMotion, Footing
from parapod.systems.machining_centre.branch import branch_joints
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.platform_mode import inverse_kinematics
from parapod.systems.machining_centre.swing import lock_sets
from parapod.systems.terrain_simulator.cells import CellsGeometry
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import slider_places
from parapod.systems.terrain_simulator.load_estimator import BenchMasses
from parapod.systems.walking_chair.gait import TrotGait, Walk, gait_motion, starting_lengths
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.leg import leg_corners, up_of_lengths
from parapod.systems.walking_chair.masses import ChairMasses, Passenger
from parapod.systems.walking_chair.trajectories import BodyMotion, Motion

CHAIR, GAIT = ChairGeometry(), TrotGait()
START = gait_motion(CHAIR, GAIT, 0.0)
LENGTHS = starting_lengths(CHAIR, Walk())
UPS = up_of_lengths(CHAIR.leg, LENGTHS)
UP = UPS[0]
CORNER = leg_corners(CHAIR.leg, UP)[0]
WORKSPACE = Workspace(PlatformGeometry(), ArmGeometry())
BENCH, PLATE = BenchGeometry.pedal(), (0.5, 0.28, 0.05)
CENTRE, MIDDLE = CentreGeometry(), (0.01, -0.02, 0.5, 0.03, 0.02, 0.05)
BATCH = (2, 5)  # unlike any shape of what is in it


def near(centre, spread=2e-3):
    """Samples of numbers near a centre of any shape."""
    centre = np.asarray(centre, dtype=float)
    return lambda random, batch: centre + spread * random.uniform(-1, 1, (*batch, *centre.shape))


def several(kind, *parts):
    """Samples of a tuple of numbers."""
    return lambda random, batch: kind(*(part(random, batch) for part in parts))


EXTENSION, ATTITUDE, GROUND = near([0.405] * 4), near([0.0] * 2, 0.02), near([0.0] * 2, 0.01)
MOTION = several(Motion, near(CORNER), near([0.0] * 3), near([0.0] * 3))
ROOMS = {
    "levelling_platform": PlatformGeometry(),
    "machining_centre": CENTRE,
    "terrain_simulator": BENCH,
    "walking_chair": CHAIR,
}
# By the room and the name of the argument; what is not listed there has no batch.
SAMPLED = {
    "levelling_platform": {
        "attitude": ATTITUDE,
        "azimuth": near(1.0, 1.0),
        "centre_of_mass": near([0.0, 0.0, 0.2]),
        "extension": EXTENSION,
        "foot_offsets": near([0.0] * 4),
        "footing": several(Footing, EXTENSION, ATTITUDE, GROUND, near([1.0] * 4, 0.1)),
        "ground": GROUND,
        "inclination": near(0.1, 0.05),
        "motion": several(ArmMotion, *[near([0.0] * 2, 0.1)] * 3),
        "point": near(WORKSPACE.tip_position((0.0, 0.0, 0.477))),
        "posture": near([0.0, 0.0, 0.477]),
    },
    "machining_centre": {
        "azimuth": near(1.0, 1.0),
        "end": near(MIDDLE, 0.02),
        "footholds": near(CENTRE.footholds),
        "joints": near(branch_joints(CENTRE, MIDDLE), 1e-5),
        "lengths": near(inverse_kinematics(CENTRE, MIDDLE)),
        "near": near(MIDDLE, 0.01),
        "pose": near(MIDDLE, 0.02),
        "poses": near(MIDDLE, 0.02),
        "start": near(MIDDLE, 0.02),
        "twist": near([0.0] * 6, 0.1),
        "wrench": near([1.0, 2.0, 3.0, 40.0, 50.0, -60.0], 5.0),
    },
    "terrain_simulator": {
        "force": near([150.0, 140.0, 10.0], 20.0),
        "load": near([10.0, -300.0, 2.0]),
        "motion": near([*PLATE, 0.5, 0.2, 1.0, 5.0, 2.0, 10.0], 0.02),
        "phi": near(0.0, 0.1),
        "pose": near(PLATE, 0.02),
        "sliders": near(slider_places(BENCH, PLATE)),
        "twist": near([0.5, 0.2, 1.0], 0.1),
        "twist_rate": near([5.0, 2.0, 10.0], 1.0),
        "z": near(0.28, 0.01),
    },
    "walking_chair": {
        "azimuth": near(0.5, 0.4),
        "body": several(
            lambda *parts: BodyMotion(
                parts[0], np.eye(3), velocity=parts[1], acceleration=parts[2]
            ),
            near(START.body.position),
            near([0.0] * 3),
            near([0.0] * 3),
        ),
        "body_position": near(START.body.position),
        "feet": near(START.feet.position),
        "from_joint": near(CORNER),
        "height": near(CHAIR.leg.retracted_height + 0.05),
        "length": near(LENGTHS + 5e-3, 1e-4),
        "lengths": near(LENGTHS),
        "motion": MOTION,
        "point": near(CORNER),
        "time": near(3.0, 1.0),
        "up": near(UP, 1e-3),
        "up_rate": near([0.0] * 3, 0.1),
        "velocity": near(np.zeros((4, 3)), 0.1),
        "x": near(0.5, 0.4),
    },
}
FIXED = {
    "arm": ArmGeometry(),
    "blend": 0.2,
    "bodies": BenchMasses(),
    "body_rotation": np.eye(3),
    "cells": CellsGeometry(),
    "corner": CHAIR.leg.corners[0],
    "gait": GAIT,
    "leg": CHAIR.leg,
    "limit": 1.0,
    "lock_set": lock_sets(CENTRE, 1)[0],
    "masses": ChairMasses(),
    "panel": Panel(),
    "params": KinematicPlatformParams(),
    "passenger": Passenger(),
    "places": CHAIR.leg.corners[1],
    "reference": "E1",
    "references": START.references,
    "sign": 1.0,
}
# Of which the batch is last, or that tell one thing of all of it.
NOT_STACKED = {"is_clear", "legs_at"}
# Arguments that are of another size in one function.
OWN = {
    "drilling_poses": {
        "along": near(0.0, 0.1),
        "across": near(0.0, 0.1),
        "height": near(0.5, 0.1),
    },
    "margins_of_terms": {"terms": near([0.1] * 7)},
    "passive_extension": {"extension": near([0.405] * 3)},
    "chair_motion": {
        "feet": several(Motion, near(START.feet.position), *[near(np.zeros((4, 3)))] * 2)
    },
    "corners_in_body": {"up": near(UPS, 1e-3)},
    "force_map_at": {"up": near(UPS, 1e-3)},
    "leg_forward": {"lengths": near(LENGTHS[0])},
    "up_of_lengths": {"lengths": near(LENGTHS[0])},
    "stroke_excess": {"length": near(LENGTHS[0])},
    "leg_jacobian_rate": {"velocity": near([0.0] * 3, 0.1)},
}


def discovered():
    for info in pkgutil.walk_packages(parapod.systems.__path__, "parapod.systems."):
        room = info.name.split(".")[2]
        if room not in SAMPLED:
            continue
        module = importlib.import_module(info.name)
        for name, value in vars(module).items():
            if (
                inspect.isfunction(value)
                and value.__module__ == module.__name__
                and not name.startswith("_")
                and "(..." in (inspect.getdoc(value) or "")
                and name not in NOT_STACKED
            ):
                yield pytest.param(room, value, id=f"{room}-{name}")


FUNCTIONS = list(discovered())


def arguments(room, function, random):
    """Arguments that have a batch, and those that have none, by their names."""
    samples, batched, fixed = SAMPLED[room] | OWN.get(function.__name__, {}), {}, {}
    for name, parameter in inspect.signature(function).parameters.items():
        if name == "geometry":
            fixed[name] = CHAIR.leg if "LegGeometry" in str(parameter.annotation) else ROOMS[room]
        elif name in samples:
            batched[name] = samples[name](random, BATCH)
        elif name in FIXED and parameter.default is parameter.empty:
            fixed[name] = FIXED[name]
        elif parameter.default is parameter.empty:
            pytest.fail(f"{function.__name__}: add '{name}' to SAMPLED or FIXED")
    return batched, fixed


def parts(value):
    """Arrays of a result, which may be a tuple of them or of such tuples."""
    if isinstance(value, tuple):
        return [array for part in value for array in parts(part)]
    return [np.asarray(value)] if value is not None else []


def at(value, index):
    """One element of a batch of arguments; what has no batch stays."""
    if hasattr(value, "_fields"):
        return type(value)(*(at(part, index) for part in value))
    return value[index] if np.shape(value)[: len(BATCH)] == BATCH else value


@pytest.mark.parametrize(("room", "function"), FUNCTIONS)
def test_a_batch_gives_the_single_results_stacked(room, function):
    batched, fixed = arguments(room, function, np.random.default_rng(0))
    whole = parts(function(**batched, **fixed))
    assert all(np.isfinite(part).any() for part in whole)
    for index in np.ndindex(BATCH):
        single = parts(function(**{k: at(v, index) for k, v in batched.items()}, **fixed))
        for all_of_it, one in zip(whole, single, strict=True):
            np.testing.assert_allclose(at(all_of_it, index), one, rtol=1e-12, atol=1e-13)
    # An argument without a batch goes with all elements of those that have one.
    for name in batched:
        mixed = parts(function(**(batched | {name: at(batched[name], (1, 2))}), **fixed))
        for some, all_of_it in zip(mixed, whole, strict=True):
            found, expected = at(some, (1, 2)), at(all_of_it, (1, 2))
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(("room", "function"), FUNCTIONS)
def test_a_wrong_size_is_refused_in_one_line_that_names_the_argument(room, function):
    batched, fixed = arguments(room, function, np.random.default_rng(1))
    parameters = inspect.signature(function).parameters
    public = {name for name in parameters if "ArrayLike" in str(parameters[name].annotation)}
    for name, value in batched.items():
        # Whoever asks for an array, instead of what makes one, asks for the right one.
        if name in public and value.ndim > len(BATCH):
            with pytest.raises((ValueError, ParapodError)) as refused:
                function(**(batched | {name: value[..., :-1]}), **fixed)
            assert name in str(refused.value)
            assert "\n" not in str(refused.value)
