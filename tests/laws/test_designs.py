"""Laws of the designs of all machines: similarity, and the words for what cannot be built."""

import copy
import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import astuple, fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from parapod.diagrams.bodies import BodyScenario
from parapod.diagrams.designs import check_design, is_published
from parapod.diagrams.machine import list_machines
from parapod.diagrams.machining_centre.real import CentreLimits
from parapod.diagrams.terrain_simulator.real import BenchLimits
from parapod.diagrams.walking_chair.real import ChairLimits
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.schema import Options, check, fields_of
from parapod.systems.levelling_platform import kinematics as of_platform
from parapod.systems.levelling_platform.statics import stand
from parapod.systems.levelling_platform.workspace import Workspace, posture_grid, tips_and_volumes
from parapod.systems.machining_centre import platform_mode as of_centre
from parapod.systems.machining_centre import swing
from parapod.systems.machining_centre.branch import branch_joints
from parapod.systems.machining_centre.statics import CentreStatics
from parapod.systems.machining_centre.workspace import nodes, survey
from parapod.systems.machining_centre.wrench import wrench_indices
from parapod.systems.terrain_simulator import kinematics as of_bench
from parapod.systems.terrain_simulator.load_estimator import (
    drive_forces,
    inertial_wrench,
    load_of_drives,
)
from parapod.systems.terrain_simulator.workspace import workspace
from parapod.systems.walking_chair import rates
from parapod.systems.walking_chair.chair import foot_corners
from parapod.systems.walking_chair.gait import gait_branches
from parapod.systems.walking_chair.leg import leg_forward, leg_inverse
from parapod.systems.walking_chair.masses import Passenger, centre_of_mass
from parapod.systems.walking_chair.rates import corner_jacobians
from parapod.systems.walking_chair.statics import STIFFNESS, force_map, rest
from parapod.systems.walking_chair.support import GaitSupport
from parapod.systems.walking_chair.trajectories import Motion

# Those of a model file have their dimensions there.
MACHINES = [each for each in list_machines() if not hasattr(each.scenario().machine, "file")]
each_machine = pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.name)
each_scale = pytest.mark.parametrize("scale", [0.6, 1.9])
CHOICES = [
    (machine, dict(zip(names, values, strict=True)))
    for machine in MACHINES
    for rules in [fields_of(type(machine.scenario().machine))]
    for names in [[name for name, (_, rule) in rules.items() if isinstance(rule, Options)]]
    for values in itertools.product(*(rules[name][1].options for name in names))
]
each_kind = pytest.mark.parametrize(
    ("machine", "choices"),
    CHOICES,
    ids=lambda value: (
        "-".join(map(str, value.values())) if isinstance(value, dict) else value.name
    ),
)
# Powers of the scale with which fields of masses grow; others are masses, and grow with its cube.
POWERS = {
    "body_height": 1,
    "centre": 1,
    "centre_of_mass": 1,
    "inertia": 5,
    "place": 1,
    "tip_place": 1,
    "lower": 0,
    "upper": 0,
    "rotation": 0,
    "tip_rotation": 0,
    "axis": 0,
    "compliance": 0,
    "foot_stiffness": 0,
    "wheel_stiffness": 0,
    "gravity": 0,
}


def parts(part: Any, key: str = "machine") -> Iterator[tuple[str, Any]]:
    if isinstance(part, list):
        for number, item in enumerate(part):
            yield from parts(item, f"{key}.{number}")
    elif is_dataclass(part):
        yield key, part
        for each in fields(part):
            yield from parts(getattr(part, each.name), f"{key}.{each.name}")


def settled(design: Any) -> Any:
    """The design with what follows from the rest, to a millimetre or from a preset, as numbers."""
    design = copy.deepcopy(design)
    if hasattr(design, "wheels"):
        design.wheels.depth_mm = -1e3 * design.wheel_geometry.height
    for name in ("link", "strut", "lever", "plate", "strut_gap"):
        if hasattr(design, f"{name}_mm"):
            setattr(design, f"{name}_mm", 1e3 * (getattr(design.geometry, name) or 0.0))
    if hasattr(design, "cells"):
        design.cells.apart_mm = 1e3 * design.cells_geometry.apart
    for name in ("plate", "tread"):
        if hasattr(design, name):
            setattr(design, name, BodyScenario(design.bodies[name].mass))
    return design


def similar(design: Any, scale: float) -> Any:
    """A design of other lengths, and of masses that go with their cube."""
    design = settled(design)
    for _, part in parts(design):
        for each in fields(part):
            value = getattr(part, each.name)
            if value is None:
                continue
            if each.name.endswith("_mm"):
                lengths = (scale * np.array(value)).tolist()
                setattr(part, each.name, lengths)
            elif each.name == "mass_kg":
                part.mass_kg = scale**3 * value
            elif each.name == "inertia_kg_m2":
                part.inertia_kg_m2 = [scale**5 * moment for moment in value]
    return design


def grown_by(factor: float, value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(grown_by(factor, item) for item in value)
    return factor * value


def scaled(masses: Any, scale: float) -> Any:
    if not is_dataclass(masses):
        raise TypeError(masses)
    grown = {}
    for each in fields(masses):
        value = getattr(masses, each.name)
        if isinstance(value, str):
            continue
        if is_dataclass(value):
            grown[each.name] = scaled(value, scale)
        elif isinstance(value, tuple) and any(map(is_dataclass, value)):
            grown[each.name] = tuple(scaled(item, scale) for item in value)
        else:
            factor = scale ** POWERS.get(each.name, 3)
            grown[each.name] = grown_by(factor, value)
    return replace(masses, **grown)


def numbers(data: Any) -> list[float]:
    items = [item for item in data if not isinstance(item, str)]
    return [x for item in items for x in (numbers(item) if isinstance(item, tuple) else [item])]


@each_machine
@each_scale
def test_a_machine_of_another_size_has_the_masses_of_a_similar_one(machine, scale):
    design = machine.scenario().machine
    other = similar(design, scale)
    check_design(other)
    found, wanted = numbers(astuple(other.masses)), numbers(astuple(scaled(design.masses, scale)))
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12)


@each_machine
def test_only_the_papers_machine_is_published(machine):
    design = machine.scenario().machine
    assert is_published(design)
    assert not is_published(similar(design, 1.1))
    heavier = copy.deepcopy(design)
    body = next(part for _, part in parts(heavier) if isinstance(part, BodyScenario))
    body.mass_kg *= 1.1
    assert not is_published(heavier)


@each_machine
def test_a_body_that_cannot_be_is_named(machine):
    bodies = [key for key, part in parts(machine.scenario().machine) if type(part) is BodyScenario]
    assert bodies
    for wrong in bodies:
        design = machine.scenario().machine
        dict(parts(design))[wrong].inertia_kg_m2 = [1.0, 1.0, 3.0, 0.0, 0.0, 0.0]
        with pytest.raises(ScenarioError, match="is of no body") as caught:
            check_design(design)
        assert caught.value.key == f"{wrong}.inertia_kg_m2"


def read_in_metres(scenario: Any, key: str, name: str) -> None:
    part = dict(parts(scenario.machine))[key]
    setattr(part, name, 1e-3 * getattr(part, name))
    check(scenario)  # a range may refuse it before
    check_design(scenario.machine)


@each_machine
def test_a_length_in_metres_is_told(machine):
    lengths = [
        (key, each.name)
        for key, part in parts(machine.scenario().machine)
        for each in fields(part)
        if each.name.endswith("_mm")
        and isinstance(value := getattr(part, each.name), float)
        and value >= 200.0
        and ".each_leg." not in key
        and ".placements." not in key
    ]
    assert lengths
    for key, name in lengths:
        scenario = machine.scenario()
        with pytest.raises(ScenarioError, match=r"another unit than mm|is outside") as caught:
            read_in_metres(scenario, key, name)
        assert caught.value.key.endswith(name)


# --- similarity

# Values of a machine whose lengths are s times the usual ones, and the powers of s in them.
type Quantities = Mapping[str, tuple[ArrayLike, ArrayLike]]
ONE, POSTURE, BY_POSTURE = 1.0, (0, 0, 1), (1, 1, 0)


def of_levelling_platform(design: Any, s: float) -> Quantities:
    geometry, ground = design.geometry, (0.02, 0.03)
    posture, extension = (0.01, -0.02, 0.45 * s), s * np.array((0.405, 0.403, 0.398, 0.4))
    soft = replace(design.masses, foot_stiffness=s**2 * design.masses.foot_stiffness)
    extensions = extension.tolist()
    stance = stand(geometry, soft, extensions, [0.0] * 4, list(ground), [0.3, 0.4])
    arm = Workspace(geometry, design.reach, ground)
    tips, volumes = tips_and_volumes(geometry, design.reach, posture_grid(geometry, 5))
    return {
        "extensions": (of_platform.inverse_kinematics(geometry, posture, ground), 1),
        "posture": (of_platform.forward_kinematics(geometry, extension, ground), POSTURE),
        "jacobian": (of_platform.posture_jacobian(geometry, posture, ground), BY_POSTURE),
        "heights": (of_platform.height_range(geometry, (0.0, 0.0), ground), 1),
        "ground": (of_platform.estimate_ground(geometry, extension, (0.01, 0.0)), 0),
        "tip": (arm.tip_position(posture), 1),
        "tip's jacobian": (arm.tip_jacobian(posture), BY_POSTURE),
        "tips": (tips, 1),
        "workspace": (volumes.sum(), 3),
        "stance": (stance.posture, POSTURE),
        "loads": (stance.load_force, 3),
        "contact": (stance.contact_force, 3),
        "feet": (np.add(stance.foot_height, s), 1),
    }


def of_walking_chair(design: Any, s: float) -> Quantities:
    geometry, masses = design.geometry, design.masses
    leg, point, rate = (
        geometry.leg,
        s * np.array((0.03, 0.05, -0.75)),
        (0.1 * s, 0.2 * s, -0.1 * s),
    )
    lengths = leg_inverse(leg, point)
    walk = SCENARIOS["walking_chair"]().gait.walk_of(leg)
    (first,) = walk.gaits
    gait = gait_branches(geometry, first, np.linspace(0.0, first.duration, 11))
    motion = rates.leg_motion(leg, Motion(point, rate, rate))
    passenger = Passenger(57.0 * s**3, 0.01 * s, 0.02 * s, 0.35 * s)
    body, whole = (0.0, 0.0, 0.0), np.tile(lengths, (4, 1))
    corners = foot_corners(geometry, body, np.eye(3), whole)
    mass, centre = centre_of_mass(masses, passenger, corners.mean(axis=-2))
    resting = rest(
        corners.reshape(12, 3),
        force_map(geometry, whole)[..., 2],
        mass * GRAVITY,
        centre,
        masses.foot_end * GRAVITY,
        s**2 * STIFFNESS,
    )
    return {
        "lengths": (lengths, 1),
        "corner": (leg_forward(leg, lengths)[0], 1),
        "angles": (leg_forward(leg, lengths)[1:], 0),
        "jacobian": (rates.leg_jacobian(leg, point), 0),
        "jacobian's rate": (rates.leg_jacobian_rate(leg, point, rate), 0),
        "speeds": (motion.velocity, 1),
        "accelerations": (motion.acceleration, 1),
        "corners": (corner_jacobians(leg, np.array((0.75 * s, 0.05, 0.03))), 0),
        "gait": (gait.length, 1),
        "margins": (GaitSupport(geometry, walk, masses).margins(passenger), 1),
        "attitude": (np.add(resting[:2], 1.0), 0),
        "height": (resting.height, 1),
        "loads": (resting.loads, 3),
        "forces": (resting.branch_forces, 3),
    }


def of_machining_centre(design: Any, s: float) -> Quantities:
    geometry = design.geometry
    pose = np.array((0.02 * s, -0.01 * s, 0.47 * s, 0.03, -0.02, 0.05))
    lengths = of_centre.leg_lengths(geometry, pose)
    assembled = of_centre.forward_kinematics(geometry, lengths, pose + 0.01 * s)
    locks = swing.close_locks(geometry, pose, swing.LockSet(1, ((2, 3), (3, 6))))
    foot = geometry.footholds[0] + (0.01 * s, 0.0, 0.02 * s, 0.0, 0.0, 0.0)
    swung = swing.swing_inverse(geometry, foot, locks, pose, longest=0.2 * s)
    box = (0.6 * s, 0.6 * s, 0.3 * s)
    reach = survey(geometry, nodes(box, 0.5 * s, 4))
    statics = CentreStatics(geometry, design.masses)
    context = statics.CreateDefaultContext()
    thrust = (150.0 * s**3, 0.6 * s**4)
    ports = {"pose": pose, "feet": geometry.footholds.ravel(), "tool_force": thrust}
    for name, value in (*ports.items(), ("clamps_closed", np.ones(geometry.limbs))):
        statics.GetInputPort(name).FixValue(context, value)
    return {
        "lengths": (lengths, 1),
        "pose": (assembled.pose, (1, 1, 1, 0, 0, 0)),
        "jacobian": (of_centre.jacobian(geometry, pose), (1, 1, 1, 0, 0, 0)),
        "joints": (branch_joints(geometry, pose), (0, 0, 0, 1, 0, 0)),
        "wrenches": (wrench_indices(geometry, pose), 0),
        "swing": (swung.lengths, 1),
        "locks": (swung.smallest_singular_value, 0),
        "reach": (reach.reachable, 1),
        "resistance": (reach.indices, 0),
        "forces": (statics.GetOutputPort("leg_force").Eval(context), 3),
    }


def of_terrain_simulator(design: Any, s: float) -> Quantities:
    geometry, masses = design.geometry, design.masses
    pose = np.array((0.6 * s, 0.75 * geometry.link, 0.03))
    # As long as gravity takes for such lengths.
    twist = np.array((0.3, -0.2, 0.4)) * (s**0.5, s**0.5, s**-0.5)
    motion = np.concatenate((pose, twist, (1.0, -2.0, 3.0 / s)))
    load, lengths = np.array((50.0, -300.0, 10.0)) * (s**3, s**3, s**4), (1,) * 3
    places, forces = (
        of_bench.slider_places(geometry, pose),
        drive_forces(geometry, masses, motion, load),
    )
    reach = workspace(geometry, (-0.1, 0.1), 0.25, 300)
    margins = np.where(np.array(of_bench.LIMITS) == "line P T A_3", 0, 1)
    left = of_bench.margins(geometry, pose)
    return {
        "places": (places, lengths),
        "pose": (of_bench.forward_kinematics(geometry, places), (1, 1, 0)),
        "jacobian": (of_bench.jacobian(geometry, pose), ((0,), (0,), (-1,))),
        "inverse jacobian": (of_bench.inverse_jacobian(geometry, pose), (0, 0, 1)),
        "speeds": (of_bench.slider_rates(geometry, pose, twist), 0.5),
        "accelerations": (of_bench.slider_accelerations(geometry, *np.split(motion, 3)), 0),
        "holding forces": (of_bench.slider_forces(geometry, pose, load), 3),
        "singularity": (of_bench.singularity(geometry, pose)[:4], 0),
        "margins": (left[np.isfinite(left)], margins[np.isfinite(left)]),
        "area": (reach.area, 2),
        "extent": (reach.extent, 1),
        "wrench": (inertial_wrench(geometry, masses, motion), (3, 3, 4)),
        "forces": (forces, 3),
        "load": (load_of_drives(geometry, masses, motion, forces), (3, 3, 4)),
    }


QUANTITIES: Mapping[str, Callable[[Any, float], Quantities]] = {
    "levelling_platform": of_levelling_platform,
    "walking_chair": of_walking_chair,
    "machining_centre": of_machining_centre,
    "terrain_simulator": of_terrain_simulator,
}
# Rounding by 1e-12 where equations of least squares are weighed against each other.
ROUNDING = {"loads": 1e5, "forces": 1e5}
SCENARIOS = {machine.name: machine.scenario for machine in MACHINES}


def design_of(machine: Any, choices: Mapping[str, Any]) -> Any:
    """The paper's machine of a kind."""
    design = machine.scenario().machine
    for name, value in choices.items():
        setattr(design, name, value)
    return design


@each_kind
@pytest.mark.parametrize("scale", [0.5, 3.0])
def test_what_follows_from_lengths_grows_with_a_power_of_them(machine, choices, scale):
    quantities, design = QUANTITIES[machine.name], design_of(machine, choices)
    usual, own = quantities(design, 1.0), quantities(similar(design, scale), scale)
    for name, (value, power) in usual.items():
        array = np.asarray(value, dtype=float)
        assert np.isfinite(array).all(), name
        assert np.abs(array).max() > 0.0, name
        factor = scale ** np.asarray(power, dtype=float)
        # Elements that are zero but for rounding are so by the largest one beside them.
        rounding = 1e-12 * np.abs(array).max(axis=-1 if factor.ndim == 0 and array.ndim else None)
        off = np.abs(np.asarray(own[name][0]) / factor - array)
        limit = ROUNDING.get(name, 1.0) * (1e-12 * np.abs(array) + np.max(rounding))
        assert (off <= limit).all(), (name, (off / limit).max())


# --- limits of guards

GUARDS: Mapping[str, type[Any]] = {
    "walking_chair": ChairLimits,
    "machining_centre": CentreLimits,
    "terrain_simulator": BenchLimits,
}
# Powers of the scale with which limits grow; others are times and shares, and do not. That of the
# chair's margin is zero itself, and that of the plate is a way and an angle.
OF_LENGTH = ("following", "fastest", "swinging", "lowest")
OF_FORCE = ("current", "unexplained", "crushed")
FORCES = ("max_force_N", "rated_current_A", "capacity_N")


@each_kind
@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_limits_of_a_guard_are_those_of_the_machine_that_it_watches(machine, choices, scale):
    if machine.name not in GUARDS:
        pytest.skip("the platform's are those of its fault detector")
    limits, design = GUARDS[machine.name], design_of(machine, choices)
    assert limits.for_machine(design) == limits()
    other = similar(design, scale)
    for _, part in parts(other):
        for name in ("max_velocity_mm_s", "max_velocity_m_s"):
            if hasattr(part, name):
                setattr(part, name, scale * getattr(part, name))
        for name in FORCES:
            if hasattr(part, name):
                setattr(part, name, scale**3 * getattr(part, name))
    own = limits.for_machine(other)
    for each in fields(limits):
        power = 1 if each.name in OF_LENGTH else 3 if each.name in OF_FORCE else 0
        factor = (scale, 1.0) if each.name == "behind" else scale**power
        wanted = np.multiply(factor, getattr(limits(), each.name))
        np.testing.assert_allclose(getattr(own, each.name), wanted, rtol=1e-12, err_msg=each.name)


# What a centre's walk is given in lengths, by part of its scenario.
OF_WALK = {
    "panel": ("radius_mm",),
    "walk": ("advance_mm", "lift_mm"),
    "process": ("clearance_mm",),
    "motion": ("rapid_mm_s", "swing_mm_s", "acceleration_mm_s2"),
}


@pytest.mark.parametrize("scale", [0.5])
def test_a_similar_centre_has_a_similar_walk(scale):
    plans = []
    for s in (1.0, scale):
        scenario = SCENARIOS["machining_centre"]()
        scenario.holes.count, scenario.walk.advance_mm, scenario.walk.steps = 0, 150.0, 1
        scenario.machine = similar(scenario.machine, s)
        scenario.machine.legs.max_force_N *= s**3
        scenario.machine.legs.max_velocity_mm_s *= s
        for part, names in OF_WALK.items():
            for name in names:
                settings = getattr(scenario, part)
                setattr(settings, name, s * getattr(settings, name))
        plans.append(scenario.plan)
    one, other = ([each.lock_set for each in plan.job.operations] for plan in plans)
    assert one == other
    assert len(one) == 3
    lengths = scale ** np.array((1, 1, 1, 0, 0, 0))
    for usual, own in zip(*(plan.job.operations for plan in plans), strict=True):
        np.testing.assert_allclose(own.way / lengths, usual.way, rtol=0.0, atol=1e-9)
