"""Laws of the designs of all machines: similarity, and the words for what cannot be built."""

import copy
import functools
import io
import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import astuple, fields, is_dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import ArrayLike
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder
from rich.console import Console

from parapod.diagrams.bodies import BodyScenario
from parapod.diagrams.built import Bodies, bodies_of_loop
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.designs import check_design, is_published
from parapod.diagrams.levelling_platform.design import LegDesign
from parapod.diagrams.levelling_platform.model import add_platform
from parapod.diagrams.machine import list_machines
from parapod.diagrams.machining_centre.model import add_centre
from parapod.diagrams.terrain_simulator.model import add_bench
from parapod.diagrams.walking_chair.model import add_chair
from parapod.sims.lab.discovery import find_entry
from parapod.sims.output.options import RunOptions
from parapod.systems.core.errors import ParapodError, ScenarioError, UnreachablePosture
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.scenario_file import load_scenario
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
from parapod.systems.physics.loops import find_constraints
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
from parapod.systems.walking_chair.statics import STIFFNESS, corner_jacobians, force_map, rest
from parapod.systems.walking_chair.support import GaitSupport
from parapod.systems.walking_chair.trajectories import Motion

MACHINES = list_machines()
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
    "arm_base": 1,
    "arm_centre": 1,
    "body_height": 1,
    "centre": 1,
    "centre_of_mass": 1,
    "arm_inertia": 5,
    "inertia": 5,
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


def scaled(masses: Any, scale: float) -> Any:
    if not is_dataclass(masses):
        raise TypeError(masses)
    grown = {}
    for each in fields(masses):
        value = getattr(masses, each.name)
        if is_dataclass(value):
            grown[each.name] = scaled(value, scale)
        else:
            factor = scale ** POWERS.get(each.name, 3)
            grown[each.name] = (
                tuple((factor * np.array(value)).tolist()) if np.ndim(value) else (factor * value)
            )
    return replace(masses, **grown)


def numbers(data: Any) -> list[float]:
    return [x for item in data for x in (numbers(item) if isinstance(item, tuple) else [item])]


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


# --- machines at random

COUNT, TRIES = 20, 60
BODIES = "multibody"  # backend on which every machine has its bodies
# Lengths of a machine about its common scale, where its parts leave room for that, and where they
# leave less; and of one leg about the others [-].
BAND, NARROW, OWN = 0.08, {"levelling_platform": 0.03}, 0.008
# Lengths that do not go with a machine, and what is stronger in a heavier one.
UNTOUCHED = ("encoder_resolution_mm", "length_error_mm", "imu_place_mm")
STRENGTHS = ("max_force_N", "motor_constant_N_V", "coulomb_friction", "force_per_current_N_A")
STRENGTHS += ("stiffness_N_um", "stiffness_Nm_rad", "capacity_N")


def drawn_design(machine: Any, random: np.random.Generator) -> Any:
    """A machine of other lengths and masses, which may be none that can be built.

    Raises:
        ScenarioError: lengths that leave no geometry.
    """
    kinds = [choices for one, choices in CHOICES if one is machine]
    design = settled(design_of(machine, kinds[random.integers(len(kinds))]))
    scale, weight = 2.0 ** random.uniform(-1.0, 1.0), 10.0 ** random.uniform(np.log10(0.2), 1.0)
    if hasattr(design, "wheels") and random.integers(2):
        design.wheels.depth_mm = None
    vary(design, random, scale, NARROW.get(machine.name, BAND))
    for _, part in parts(design):
        if isinstance(part, BodyScenario):
            part.mass_kg *= float(np.clip(weight * random.uniform(0.7, 1.4), 0.2, 10.0))
        for name in STRENGTHS:
            if hasattr(part, name):
                setattr(part, name, max(1.0, weight) * getattr(part, name))
    if hasattr(design, "each_leg"):
        design.each_leg = [own_leg(leg) for leg in design.geometry.legs]
        vary(design.each_leg, random, 1.0, OWN, 0.0, np.inf)
    return design


def own_leg(leg: Any) -> LegDesign:
    lengths = {f"{name}_mm": 1e3 * getattr(leg, name) for name in ("l_3", "l_4", "l_6", "l_7")}
    hip = (-1e3 * leg.l_x, -1e3 * leg.l_y, -1e3 * leg.l_z)
    return LegDesign(*hip, **lengths)


def vary(
    design: Any,
    random: np.random.Generator,
    scale: float,
    band: float,
    low: float = 0.5,
    high: float = 2.0,
) -> None:
    """Gives each length a factor of its own about a scale."""
    for _, part in parts(design):
        for each in fields(part):
            value = getattr(part, each.name)
            if each.name.endswith("_mm") and each.name not in UNTOUCHED and value is not None:
                own = scale * random.uniform(1.0 - band, 1.0 + band, np.shape(value))
                factor = np.clip(own, low, high)
                setattr(part, each.name, (factor * value).tolist())


def drawn_machines(machine: Any) -> tuple[tuple[Any, ...], tuple[ScenarioError, ...]]:
    """The first admissible ones, and refusals of those that were drawn before the last of them."""
    return _drawn_machines(machine.name)


@functools.cache
def _drawn_machines(name: str) -> tuple[tuple[Any, ...], tuple[ScenarioError, ...]]:
    machine = next(one for one in MACHINES if one.name == name)
    random, designs, refusals = np.random.default_rng(11), [], []
    while len(designs) < COUNT and len(designs) + len(refusals) < TRIES:
        try:
            design = drawn_design(machine, random)
            check_design(design)
            designs.append(design)
        except ScenarioError as refusal:
            refusals.append(refusal)
    return tuple(designs), tuple(refusals)


each_drawn = pytest.mark.parametrize(
    ("machine", "number"),
    [(machine, number) for machine in MACHINES for number in range(COUNT)],
    ids=[f"{machine.name} {number}" for machine in MACHINES for number in range(COUNT)],
)


@each_machine
def test_a_good_share_of_machines_at_random_can_be_built_and_others_are_refused_in_a_line(machine):
    designs, refusals = drawn_machines(machine)
    assert len(designs) == COUNT, [str(refusal) for refusal in refusals]
    for refusal in refusals:
        assert "\n" not in str(refusal)
        assert refusal.key.startswith("machine")
        assert str(refusal).startswith(refusal.key.rpartition(".")[0] or refusal.key)


def gaps_of(bodies: Bodies) -> list[float]:
    """Distances by which loops are open, angles of welds and of coupled joints [m, rad]."""
    plant, context = bodies.plant, bodies.context
    constraints = find_constraints(plant)
    assert constraints.others == 0
    gaps = []
    for ball in constraints.balls:
        ends = ((ball.body, ball.point), (ball.other, ball.other_point))
        one, other = (plant.EvalBodyPoseInWorld(context, body) @ point for body, point in ends)
        gaps.append(float(np.linalg.norm(one - other)))
    for weld in constraints.welds:
        X_WP, X_WQ = (
            plant.EvalBodyPoseInWorld(context, body) @ frame
            for body, frame in ((weld.body, weld.frame), (weld.other, weld.other_frame))
        )
        off = X_WP.InvertAndCompose(X_WQ)
        gaps += [float(np.linalg.norm(off.translation())), off.rotation().ToAngleAxis().angle()]
    for coupling in constraints.couplings:
        at, led = (joint.GetOnePosition(context) for joint in (coupling.joint, coupling.leader))
        gaps.append(abs(at - coupling.ratio * led - coupling.offset))
    return gaps


# Masses of a whole machine in closed form [kg].
MASSES: Mapping[str, Callable[[Any], float]] = {
    "levelling_platform": lambda masses: masses.mass + masses.arm_mass,
    "walking_chair": lambda masses: masses.total,
    "machining_centre": lambda masses: masses.platform,
    "terrain_simulator": lambda masses: (
        3 * masses.slider + 2 * masses.link.mass + masses.strut.mass + masses.plate.mass
    ),
}


@each_drawn
def test_loops_of_bodies_are_closed_where_the_closed_form_has_them_and_weigh_as_much(
    machine, number
):
    # At rest: a machine with a plan makes it as its loop is built.
    idle = ("holes.count=0",) if machine.name == "machining_centre" else ()
    scenario = load_scenario(machine.scenario, None, None, (f"backend={BODIES}", *idle))
    scenario.machine = drawn_machines(machine)[0][number]
    bodies = bodies_of_loop(ClosedLoop(machine, scenario, log=()))
    gaps = gaps_of(bodies)
    assert max(gaps) < 1e-9
    design, plant = scenario.machine, bodies.plant
    links = [plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies())]
    own = [link for link in links if link.name() in design.bodies]
    mass = MASSES[machine.name](design.masses)
    if machine.name == "machining_centre":
        mass += design.limbs * design.masses.limb
    assert sum(link.default_mass() for link in own) == pytest.approx(mass, rel=1e-12)
    assert {link.name() for link in own} == set(design.bodies)


# --- statics


def platform_s_centre(design: Any) -> None:
    """The centre of mass, legs in their middle, and that of the arm."""
    geometry, masses = design.geometry, design.masses
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=1.0)
    model, context = add_platform(plant, geometry=geometry, structure=design.structure), None
    context = plant.CreateDefaultContext()
    middle = np.full(4, 0.5 * (geometry.extension_min + geometry.extension_max))
    upright = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    plant.SetPositions(context, model.positions_at(middle, upright, (0.0, 0.0)))
    ground = plant.GetBodyByName("ground").index()
    others = [i for i in map(BodyIndex, range(1, plant.num_bodies())) if i != ground]
    inertia = plant.CalcSpatialInertia(context, model.base.body_frame(), others)
    wanted = masses.centre_with((*masses.arm_base[:2], masses.arm_base[2] + masses.arm_centre))
    np.testing.assert_allclose(inertia.get_com(), wanted, rtol=0.0, atol=1e-12 * design.size)


def chair_s_body(design: Any) -> None:
    """The height of the body's centre of mass."""
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=1.0)
    model = add_chair(plant, Passenger(), design.geometry, design.bodies)
    assert model.body.default_com()[2] == pytest.approx(design.masses.body_height, rel=1e-12)


def bench_s_weight(design: Any) -> None:
    """The weight of all bodies, as the plate bears it."""
    geometry = design.geometry
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=1.0)
    model = add_bench(plant, geometry, bodies=design.bodies)
    context = plant.CreateDefaultContext()
    pose = (0.5 * (geometry.slider_min + geometry.slider_max), design.place()[1], 0.02)
    model.stand(context, pose)
    forces = plant.CalcGravityGeneralizedForces(context)[model.order]
    wrench = [-model.motion(pose, twist)[1] @ forces for twist in np.eye(3)]
    closed = inertial_wrench(geometry, design.masses, (*pose, *[0.0] * 6))
    np.testing.assert_allclose(closed, wrench, rtol=1e-9, atol=1e-9 * abs(wrench[1]))


def centre_s_parts(design: Any) -> None:
    """The masses of platform and limb, each by itself."""
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=1.0)
    model = add_centre(plant, design.geometry, bodies=design.bodies)
    context, masses = plant.CreateDefaultContext(), design.masses
    for instance, mass in (
        (model.platform.model_instance(), masses.platform),
        *((limb, masses.limb) for limb in model.limbs),
    ):
        assert plant.CalcTotalMass(context, [instance]) == pytest.approx(mass, rel=1e-12)


STATICS: Mapping[str, Callable[[Any], None]] = {
    "levelling_platform": platform_s_centre,
    "walking_chair": chair_s_body,
    "machining_centre": centre_s_parts,
    "terrain_simulator": bench_s_weight,
}


@each_machine
def test_statics_in_closed_form_are_those_of_the_bodies(machine):
    for design in drawn_machines(machine)[0]:
        STATICS[machine.name](design)


# --- round trips: values, and what comes back


def platform_s_trips(design: Any, random: np.random.Generator) -> Iterator[tuple[Any, Any]]:
    geometry, ground = design.geometry, random.uniform(-0.01, 0.01, 2)
    attitude = random.uniform(-0.005, 0.005, (50, 2))
    low, high = of_platform.height_range(geometry, attitude, ground).T
    height = low + random.uniform(0.0, 1.0, 50) * (high - low)
    posture = np.column_stack((attitude, height))[high > low]
    assert len(posture) > 25
    extension = of_platform.inverse_kinematics(geometry, posture, ground)
    for legs in ((0, 1, 2), (1, 2, 3), None):
        back = of_platform.forward_kinematics(geometry, extension, ground, legs)
        yield posture, back
    arm = Workspace(geometry, design.reach, ground)
    yield posture, arm.posture_reaching(arm.tip_position(posture))
    yield (
        np.tile(ground, (len(posture), 1)),
        of_platform.estimate_ground(geometry, extension, posture[:, :2]),
    )


def chair_s_trips(design: Any, random: np.random.Generator) -> Iterator[tuple[Any, Any]]:
    leg = design.geometry.leg
    way = leg.stroke * random.uniform(-0.3, 0.3, (50, 3))
    points = way - (0.0, 0.0, leg.retracted_height + 0.5 * leg.stroke)
    yield points, leg_forward(leg, leg_inverse(leg, points))[0]


def centre_s_trips(design: Any, random: np.random.Generator) -> Iterator[tuple[Any, Any]]:
    geometry = design.geometry
    middle = 0.5 * (geometry.stroke_min + geometry.stroke_max)
    spread = np.array((0.1, 0.1, 0.1, 0.1, 0.1, 0.1)) * (*[middle] * 3, 1.0, 1.0, 1.0)
    poses = spread * random.uniform(-1.0, 1.0, (50, 6)) + (0.0, 0.0, middle, 0.0, 0.0, 0.0)
    lengths = of_centre.leg_lengths(geometry, poses)
    near = poses + 0.1 * spread * random.uniform(-1.0, 1.0, poses.shape)
    yield poses, of_centre.forward_kinematics(geometry, lengths, near).pose


def bench_s_trips(design: Any, random: np.random.Generator) -> Iterator[tuple[Any, Any]]:
    geometry, (x, z) = design.geometry, design.place()
    size = geometry.link * np.array((0.1, 0.1, 0.0)) + (0.0, 0.0, 0.05)
    poses = size * random.uniform(-1.0, 1.0, (50, 3)) + (x, z, 0.0)
    yield poses, of_bench.forward_kinematics(geometry, of_bench.slider_places(geometry, poses))


TRIPS: Mapping[str, Callable[[Any, np.random.Generator], Iterator[tuple[Any, Any]]]] = {
    "levelling_platform": platform_s_trips,
    "walking_chair": chair_s_trips,
    "machining_centre": centre_s_trips,
    "terrain_simulator": bench_s_trips,
}


@each_machine
def test_forward_and_inverse_kinematics_of_machines_at_random_undo_each_other(machine):
    for number, design in enumerate(drawn_machines(machine)[0]):
        for values, back in TRIPS[machine.name](design, np.random.default_rng(number)):
            size = np.abs(values).max()
            np.testing.assert_allclose(back, values, rtol=0.0, atol=1e-9 * size, err_msg=number)


# --- jobs


def job_of_platform(design: Any) -> tuple[str, ...]:
    return ("ground.roll_deg=1", "ground.pitch_deg=1.5")


def job_of_chair(design: Any) -> tuple[str, ...]:
    return ("gait.way=forward",)


def job_of_centre(design: Any) -> tuple[str, ...]:
    size, tool = design.geometry.size, 1e3 * design.geometry.tool_length
    lengths = {
        "holes.depth_mm": 2.0,
        "panel.radius_mm": 3000.0,
        "walk.advance_mm": 120.0,
        "walk.lift_mm": 20.0,
        "process.clearance_mm": 8.0,
    }
    own = [f"{key}={size * length}" for key, length in lengths.items()]
    fast = ("rapid_mm_s=150", "swing_mm_s=120", "acceleration_mm_s2=1000")
    return (
        *("holes.count=1", "walk.steps=1", f"walk.height_mm={tool + 40.0 * size}", *own),
        *("control.settling=0.1", *(f"motion.{each}" for each in fast)),
    )


def job_of_bench(design: Any) -> tuple[str, ...]:
    return ("gait.strides=2", f"gait.speed_m_s={1.4 * min(1.0, design.geometry.size)}")


class Trial(NamedTuple):
    """Trials of a kind of machine with its default job.

    Attributes:
        settings: settings of the job that go with a design.
        often: numbers of machines that do it every day.
        bodies: settings with rigid bodies.
        often_bodies: numbers of machines that do it with rigid bodies every day.
        agreement: largest difference of an error by rigid bodies from the one without, by its
            bound [-]; about twice that of the paper's machine.
    """

    settings: Callable[[Any], tuple[str, ...]]
    often: int
    bodies: tuple[str, ...] = ()
    often_bodies: int = 0
    agreement: float = 0.5


COARSE = ("plant.leg_model=reduced", "plant.time_step=0.004")
TRIALS = {
    "levelling_platform": Trial(job_of_platform, 3, COARSE, 1, 0.3),
    "walking_chair": Trial(job_of_chair, 1, agreement=0.8),
    "machining_centre": Trial(job_of_centre, 0),
    # Without a leg on it nothing takes the plate from its path.
    "terrain_simulator": Trial(job_of_bench, 3, (), 1, 1.0),
}
WITH_BODIES = 3  # machines of each kind whose job is also done by rigid bodies
ERRORS = ("deg", "mm", "mrad", "N", "m/s")  # units of metrics that both have


@functools.cache
def result_of(name: str, number: int, backend: str) -> Any:
    """Result of the default job; a text if it is refused."""
    machine, trial = next(one for one in MACHINES if one.name == name), TRIALS[name]
    entry = find_entry(machine.experiment)
    experiment, design = entry.load(), drawn_machines(machine)[0][number]
    more = trial.bodies if backend == BODIES else ()
    settings = (f"backend={backend}", *trial.settings(design), *more)
    scenario = load_scenario(experiment.schema, entry.default_scenario, None, settings)
    scenario.machine = design
    try:
        experiment.check(scenario)
    except ParapodError as refusal:
        return str(refusal)
    try:
        return experiment.execute(scenario, RunOptions(console=Console(file=io.StringIO())))
    except UnreachablePosture as refusal:  # on ground that is known only then
        return str(refusal)


def trials(count: int, often: str) -> pytest.MarkDecorator:
    """Parameters of the first machines of each kind, of which some are tried every day."""
    cases = [
        pytest.param(
            machine,
            number,
            id=f"{machine.name} {number}",
            marks=[] if number < getattr(TRIALS[machine.name], often) else [pytest.mark.slow],
        )
        for machine in MACHINES
        for number in range(count)
    ]
    return pytest.mark.parametrize(("machine", "number"), cases)


def admitted(machine: Any, number: int, backend: str) -> Any:
    """The result of a job; skips one that is refused."""
    result = result_of(machine.name, number, backend)
    if isinstance(result, str):
        assert "\n" not in result
        pytest.skip(result)
    return result


@trials(COUNT, "often")
def test_a_machine_at_random_holds_the_bounds_of_its_default_job(machine, number):
    result = admitted(machine, number, "kinematic")
    assert any(metric.is_bounded for metric in result.metrics)
    assert result.broken == ()


@trials(WITH_BODIES, "often_bodies")
def test_rigid_bodies_of_a_machine_at_random_do_what_its_closed_form_does(machine, number):
    usual, bodies = (admitted(machine, number, each) for each in ("kinematic", BODIES))
    assert bodies.broken == ()
    by_bodies = {metric.key: metric for metric in bodies.metrics}
    compared = [
        metric
        for metric in usual.metrics
        if metric.bound and metric.unit in ERRORS and metric.key in by_bodies
    ]
    assert compared
    for metric in compared:
        off = abs(by_bodies[metric.key].value - metric.value)
        assert off <= TRIALS[machine.name].agreement * metric.bound, metric.key
