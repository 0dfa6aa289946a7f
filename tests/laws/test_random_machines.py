"""Laws of machines at random: their bodies, statics, kinematics and default jobs."""

import functools
import io
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder
from rich.console import Console

from parapod.diagrams.bodies import BodyScenario
from parapod.diagrams.built import Bodies, bodies_of_loop
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.designs import check_design
from parapod.diagrams.levelling_platform.design import LegDesign
from parapod.diagrams.levelling_platform.model import add_platform
from parapod.diagrams.machining_centre.model import add_centre
from parapod.diagrams.terrain_simulator.model import add_bench
from parapod.diagrams.walking_chair.model import add_chair
from parapod.sims.lab.discovery import find_entry
from parapod.sims.output.options import RunOptions
from parapod.systems.core.errors import ParapodError, ScenarioError, UnreachablePosture
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.levelling_platform import kinematics as of_platform
from parapod.systems.levelling_platform.workspace import Workspace
from parapod.systems.machining_centre import platform_mode as of_centre
from parapod.systems.mechanism.mechanism import Mechanism
from parapod.systems.physics.loops import find_constraints
from parapod.systems.terrain_simulator import kinematics as of_bench
from parapod.systems.terrain_simulator.load_estimator import (
    inertial_wrench,
)
from parapod.systems.walking_chair.leg import leg_forward, leg_inverse
from parapod.systems.walking_chair.masses import Passenger
from tests.laws.test_designs import CHOICES, MACHINES, design_of, each_machine, parts, settled

COUNT, TRIES = 20, 120
BODIES = "multibody"  # backend on which every machine has its bodies
# Lengths of a machine about its common scale, where its parts leave room for that, and where they
# leave less; and of one leg about the others [-].
BAND, NARROW, OWN = 0.08, {"levelling_platform": 0.03}, 0.008
# Lengths that do not go with a machine, and what is stronger in every other heavier one; the rest
# have the paper's drives.
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
    strength = max(1.0, weight) if random.integers(2) else 1.0
    for _, part in parts(design):
        if isinstance(part, BodyScenario):
            part.mass_kg *= float(np.clip(weight * random.uniform(0.7, 1.4), 0.2, 10.0))
        for name in STRENGTHS:
            if hasattr(part, name):
                setattr(part, name, strength * getattr(part, name))
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


def posed_again(bodies: Bodies) -> float:
    """Distance of joints from where they were after all without motors were put elsewhere.

    Numerically, by the loops of the bodies alone: the closed form and the mechanism of the model
    prove each other.
    """
    mechanism, q = Mechanism(bodies.plant), bodies.plant.GetPositions(bodies.context)
    random, moved = np.random.default_rng(0), q.copy()
    idle = {int(index) for index in mechanism.mobility.idle}
    for joint in mechanism.passive:
        if int(joint.index()) not in idle and joint.num_positions() == 1:
            length = mechanism.size if mechanism.is_length[joint.velocity_start()] else 1.0
            moved[joint.position_start()] += 0.01 * length * random.uniform(-1.0, 1.0)
    motors = {mechanism.name(j): float(q[j.position_start()]) for j in mechanism.motors}
    pose = mechanism.solve(fixed=motors, near=moved)
    assert pose.is_closed
    return float(np.abs(pose.q - q).max())


# Masses of a whole machine in closed form [kg].
MASSES: Mapping[str, Callable[[Any], float]] = {
    "levelling_platform": lambda masses: masses.total,
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
    assert posed_again(bodies) < 1e-9
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
    wanted = masses.centre_with([0.0] * masses.arm.count)
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
    size = design.geometry.size
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
        *("holes.count=1", "walk.steps=1", *own),
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
