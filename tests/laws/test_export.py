"""A machine that is written for other programs is the machine that is simulated.

Proved for every machine that is installed and has bodies, and for some that are not the papers'.
"""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    HalfSpace,
    Mesh,
    Role,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import AddMultibodyPlantConstraints
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import (
    BallRpyJoint,
    BodyIndex,
    FixedOffsetFrame,
    JacobianWrtVariable,
    QuaternionFloatingJoint,
    RevoluteJoint,
    SpatialInertia,
    UnitInertia,
    WeldJoint,
)
from pydrake.solvers import MathematicalProgram
from pydrake.systems.framework import DiagramBuilder
from scipy.linalg import eigh, null_space

from parapod.diagrams.built import bodies_of_loop
from parapod.diagrams.drawing import visuals_kept
from parapod.diagrams.machine import list_machines
from parapod.sims.cli.main import main
from parapod.sims.lab.discovery import find_entry
from parapod.sims.output.model_file import notes, write_model
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.physics.description import Description
from parapod.systems.physics.model_files import ENDLESS
from parapod.systems.physics.mujoco.model import MujocoModel

_MACHINES = Path(__file__).parents[2] / "examples" / "machines"
# Experiment, file of a machine, and keys.
CASES = {
    **{m.name: (m.experiment, None, ()) for m in list_machines() if "multibody" in m.plants},
    "large platform": ("level", "large_platform.yaml", ()),
    "reduced platform": ("level", None, ("plant.leg_model=reduced", "plant.wheels=rolling")),
    "platform on pads": ("level", None, ("ground.foot_heights_mm=[3,0,-2,1]", "seed=4")),
    "child's chair": ("chair-walk", "childs_chair.yaml", ()),
    "empty chair": ("chair-walk", None, ("passenger.mass_kg=0",)),
    "five limbs": ("centre-walk", "five_limbs.yaml", ()),
    "another leg on the bench": ("bench-leg", None, ()),
    "treadmill": ("bench-walk", None, ("machine.configuration=treadmill",)),
}
_EXACT = {"rtol": 1e-9, "atol": 1e-9}
# MuJoCo's loops are springs of 1e10 N/m in a row with drives of 1e7 to 2.5e8 N/m: 2.5 % of
# stiffness, of which .2 % of a frequency has been seen. Of frequencies of zero, rounding of that
# stiffness leaves .04 rad/s.
_SOFT, _STILL = 5e-3, 0.2
# Steps of a machine that is put down, and of a leg that nothing drives; ways by which two models
# part that add different masses of grams to their loops [m, rad].
_STEPS, _FALLS, _APART = 300, 100, 5e-5
_ROLES = (Role.kIllustration, Role.kProximity)


@cache
def built(case):
    """A case as it is simulated, and what keeps it alive."""
    name, machine, keys = CASES[case]
    entry = find_entry(name)
    experiment = entry.load()
    path = machine and _MACHINES / machine
    keys = ("backend=multibody", *keys)
    scenario = load_scenario(experiment.schema, entry.default_scenario, None, keys, path)
    with visuals_kept():
        loop = experiment.loop(scenario)
    bodies = bodies_of_loop(loop)
    machine = Description(bodies.plant, bodies.context, bodies.scene_graph, "machine")
    return machine, bodies, loop


class Loaded:
    """A written file as Drake loads it, in the pose in which the machine stands."""

    def __init__(self, machine, path):
        self.machine, self.form = machine, path.suffix
        self.builder = DiagramBuilder()
        plant, self.scene_graph = AddMultibodyPlantSceneGraph(self.builder, 1e-3)
        (self.instance,) = Parser(plant).AddModels(path)
        plant.Finalize()
        self.plant, self.context = plant, plant.CreateDefaultContext()
        # Indices of the positions and velocities of the original among those of this one.
        self.q = np.zeros(machine.plant.num_positions(), dtype=int)
        self.v = np.zeros(machine.plant.num_velocities(), dtype=int)
        for name, joint in zip(machine.joint_names, machine.joints, strict=True):
            if isinstance(joint, QuaternionFloatingJoint):
                body = self.body(joint.child_body())
                self.q[joint.position_start() :][:7] = body.floating_positions_start() + np.arange(
                    7
                )
                start = body.floating_velocities_start_in_v()
                self.v[joint.velocity_start() :][:6] = start + np.arange(6)
            elif joint.num_positions():
                loaded = plant.GetJointByName(name)
                self.q[joint.position_start()] = loaded.position_start()
                self.v[joint.velocity_start()] = loaded.velocity_start()
        self.put(machine.plant.GetPositions(machine.context))

    def body(self, body):
        return self.plant.GetBodyByName(self.machine.link(body))

    def put(self, q):
        positions = np.zeros(self.plant.num_positions())
        positions[self.q] = q
        self.plant.SetPositions(self.context, positions)
        return positions


@cache
def loaded(case, form, folder):
    machine, _, _ = built(case)
    path = Path(folder) / f"{form}.{form}"
    write_model(path, form, machine)
    return machine, Loaded(machine, path)


@pytest.fixture(params=CASES)
def case(request):
    return request.param


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("robots")


@pytest.fixture(params=["urdf", "sdf"])
def again(request, case, folder):
    place = folder / case
    place.mkdir(exist_ok=True)
    return loaded(case, request.param, place)


def test_links_and_masses_are_the_same(again):
    machine, other = again
    names = [other.plant.get_body(BodyIndex(i)).name() for i in range(other.plant.num_bodies())]
    more = set(names) - set(machine.links)
    # Frames that close loops are links of URDF, without mass.
    assert more in (set(), {name for closure in machine.closures for name in closure.names})
    assert all(other.plant.GetBodyByName(name).default_mass() == 0.0 for name in more)
    assert len(names) == len(machine.links) + len(more)
    mass = machine.plant.CalcTotalMass(machine.context)
    assert other.plant.CalcTotalMass(other.context) == pytest.approx(mass, rel=1e-9)
    for body in machine.bodies[1:]:
        one, two = (
            each.CalcSpatialInertiaInBodyFrame(context).CopyToFullMatrix6()
            for each, context in ((body, machine.context), (other.body(body), other.context))
        )
        np.testing.assert_allclose(two, one, **_EXACT)


def test_poses_centre_and_mass_matrix_are_the_same(again):
    machine, other = again
    for body in machine.bodies:
        one = machine.plant.EvalBodyPoseInWorld(machine.context, body)
        two = other.plant.EvalBodyPoseInWorld(other.context, other.body(body))
        np.testing.assert_allclose(two.GetAsMatrix4(), one.GetAsMatrix4(), **_EXACT)
    one = machine.plant.CalcCenterOfMassPositionInWorld(machine.context)
    two = other.plant.CalcCenterOfMassPositionInWorld(other.context)
    np.testing.assert_allclose(two, one, **_EXACT)
    one = machine.plant.CalcMassMatrix(machine.context)
    two = other.plant.CalcMassMatrix(other.context)[np.ix_(other.v, other.v)]
    np.testing.assert_allclose(two, one, rtol=1e-9, atol=1e-9 * np.abs(one).max())


def test_joints_and_drives_are_the_same(again):
    machine, other = again
    assert other.plant.num_velocities() == machine.plant.num_velocities()
    assert other.plant.num_actuators() == machine.plant.num_actuators()
    actuators = {
        actuator.joint().name(): actuator
        for actuator in map(other.plant.get_joint_actuator, other.plant.GetJointActuatorIndices())
    }
    for name, joint in zip(machine.joint_names, machine.joints, strict=True):
        if joint.num_positions() != 1:
            continue
        two = other.plant.GetJointByName(name)
        assert type(two) is type(joint)
        for what in ("position_lower", "position_upper", "velocity_lower", "velocity_upper"):
            limits = [getattr(one, f"{what}_limits")()[0] for one in (joint, two)]
            assert np.clip(limits[1], -ENDLESS, ENDLESS) == pytest.approx(
                np.clip(limits[0], -ENDLESS, ENDLESS), rel=1e-9
            )
        damping = [one.default_damping() for one in (joint, two)]
        assert damping[1] == pytest.approx(damping[0], rel=1e-9)
        if name in machine.actuators:
            drives = machine.actuators[name], actuators[name]
            one, two = (np.clip(drive.effort_limit(), 0.0, ENDLESS) for drive in drives)
            assert two == pytest.approx(one, rel=1e-9)
            assert drives[1].has_controller() == drives[0].has_controller()
            if drives[0].has_controller():
                one, two = (drive.get_controller_gains() for drive in drives)
                assert (two.p, two.d) == pytest.approx((one.p, one.d), rel=1e-9)


def held(plant, q):
    """Values and bounds of the constraints that close loops or couple joints."""
    program, context = MathematicalProgram(), plant.CreateDefaultContext()
    variables = program.NewContinuousVariables(len(q))
    index = {variable.get_id(): i for i, variable in enumerate(variables)}
    values = {"Ball": [], "Coupler": []}
    for binding in AddMultibodyPlantConstraints(plant, variables, program, context):
        constraint = binding.evaluator()
        kind = constraint.get_description().partition(" ")[0]
        if kind in values:
            own = q[[index[v.get_id()] for v in binding.variables()]]
            residual = constraint.Eval(own) - constraint.lower_bound()
            values[kind].append(residual if kind == "Ball" else np.abs(residual))
    return values


def _rounded(row):
    return np.round(row, 6).tolist()


def test_loops_close_in_the_same_places(again):
    machine, other = again
    generator = np.random.default_rng(1)
    for _ in range(5):
        q = generator.uniform(-1.0, 1.0, machine.plant.num_positions())
        one, two = held(machine.plant, q), held(other.plant, other.put(q))
        for kind in one:
            assert len(two[kind]) == len(one[kind])
            rows = [
                sorted(np.array(of[kind]), key=lambda row: tuple(row.round(6)))
                for of in (one, two)
            ]
            np.testing.assert_allclose(rows[1], rows[0], **_EXACT)
    other.put(machine.plant.GetPositions(machine.context))
    for closure in machine.closures:
        poses = [
            other.plant.GetFrameByName(name).CalcPoseInWorld(other.context)
            for name in closure.names
        ]
        np.testing.assert_allclose(poses[1].translation(), poses[0].translation(), atol=1e-6)
        if closure.kind == "weld":
            matrices = [pose.rotation().matrix() for pose in poses]
            np.testing.assert_allclose(matrices[1], matrices[0], atol=1e-6)


def sizes(shape):
    if isinstance(shape, Box):
        return tuple(shape.size())
    if isinstance(shape, Ellipsoid):
        return shape.a(), shape.b(), shape.c()
    if isinstance(shape, Cylinder | Capsule):
        return shape.radius(), shape.length()
    if isinstance(shape, Sphere):
        return (shape.radius(),)
    if isinstance(shape, Mesh | Convex):
        return tuple(shape.scale3())
    return ()


def parts_of(shape):
    """Shapes to be seen as URDF has them: capsules are cylinders and balls, ellipsoids balls."""
    if isinstance(shape.shape, Ellipsoid):
        return [replace(shape, shape=Sphere(np.prod(sizes(shape.shape)) ** (1 / 3)))]
    if not isinstance(shape.shape, Capsule):
        return [shape]
    radius, length = sizes(shape.shape)
    ends = [
        replace(
            shape,
            name=f"{shape.name}_{name}",
            pose=shape.pose @ RigidTransform(np.array((0.0, 0.0, sign * length / 2))),
            shape=Sphere(radius),
        )
        for name, sign in (("top", 1.0), ("bottom", -1.0))
    ]
    return [replace(shape, shape=Cylinder(radius, length)), *ends]


def test_shapes_are_the_same(again):
    machine, other = again
    copy = Description(other.plant, other.context, other.scene_graph, "copy")
    seen = 0
    for body in machine.bodies:
        for role in _ROLES:
            one, two = list(machine.shapes(body, role)), list(copy.shapes(other.body(body), role))
            if other.form == ".urdf" and role == Role.kIllustration:
                one = [part for shape in one for part in parts_of(shape)]
            assert [shape.name for shape in two] == [shape.name for shape in one]
            for a, b in zip(one, two, strict=True):
                seen += 1
                assert b.contact == a.contact
                assert (b.colour is None) == (a.colour is None)
                if a.colour is not None:
                    assert b.colour.rgba == pytest.approx(a.colour.rgba)
                if isinstance(a.shape, HalfSpace):
                    # URDF has a box whose upper side is the plane.
                    height = 0.5 * b.shape.height() if isinstance(b.shape, Box) else 0.0
                    up = b.pose.rotation().matrix()[:, 2]
                    np.testing.assert_allclose(up, a.pose.rotation().matrix()[:, 2], **_EXACT)
                    top = b.pose.translation() + height * up
                    np.testing.assert_allclose(top, a.pose.translation(), **_EXACT)
                    continue
                assert type(b.shape) is type(a.shape)
                assert sizes(b.shape) == pytest.approx(sizes(a.shape), rel=1e-9)
                np.testing.assert_allclose(b.pose.GetAsMatrix4(), a.pose.GetAsMatrix4(), **_EXACT)
        if (axis := machine.belt(body)) is not None:
            np.testing.assert_allclose(copy.belt(other.body(body)), axis, **_EXACT)
    assert seen > 10, "nothing is seen"


class InMujoco:
    """A written MJCF as MuJoCo loads it, in its key frame."""

    def __init__(self, machine, path):
        mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
        write_model(path, "mjcf", machine)
        self.mujoco, self.model = mujoco, mujoco.MjModel.from_xml_path(str(path))
        self.data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        mujoco.mj_forward(self.model, self.data)

    def springs(self):
        """Jacobian, stiffness and mass of the constraints that close loops or couple joints."""
        data, step = self.data, self.model.opt.timestep
        count = data.ne
        # With a row of `efc_KBIP` a gap x makes MuJoCo accelerate by -K I x - B x'. The mass that
        # it adds to a constraint is what the step's damping and stiffness leave of 1 / R.
        rate, damping = (
            data.efc_KBIP[:count, 0] * data.efc_KBIP[:count, 2],
            data.efc_KBIP[:count, 1],
        )
        mass = 1.0 / data.efc_R[:count] / (1.0 + step * damping + step**2 * rate)
        return data.efc_J.reshape(-1, self.model.nv)[:count], rate * mass, mass


@pytest.fixture
def in_mujoco(case, folder):
    machine, _, _ = built(case)
    place = folder / case
    place.mkdir(exist_ok=True)
    return machine, InMujoco(machine, place / "machine.xml")


def test_mujoco_loads_the_same_masses_in_the_same_places(in_mujoco):
    machine, other = in_mujoco
    assert other.model.nbody == len(machine.bodies)
    for body, name in zip(machine.bodies[1:], machine.links[1:], strict=True):
        mass, centre, _ = machine.inertia(body)
        two = other.model.body(name)
        assert two.mass[0] == pytest.approx(mass, rel=1e-9)
        X_WB = machine.plant.EvalBodyPoseInWorld(machine.context, body)
        np.testing.assert_allclose(other.data.body(name).xpos, X_WB.translation(), **_EXACT)
        if mass > 0.0:
            np.testing.assert_allclose(
                other.data.body(name).xipos, X_WB.multiply(centre), **_EXACT
            )
    moved = [joint.num_velocities() for joint in machine.joints]
    assert other.model.nv == sum(moved)


def test_limits_and_rotors_of_drives_are_in_the_file(in_mujoco):
    machine, other = in_mujoco
    assert other.model.nu == len(machine.actuators)
    for name, actuator in machine.actuators.items():
        effort, servo = actuator.effort_limit(), other.model.actuator(name)
        assert bool(servo.forcelimited[0]) == np.isfinite(effort)
        if np.isfinite(effort):
            assert servo.forcerange == pytest.approx([-effort, effort], rel=1e-9)
        rotor = actuator.calc_reflected_inertia(machine.context)
        assert other.model.joint(name).armature[0] == pytest.approx(rotor, rel=1e-9)


def test_mujoco_closes_the_same_loops(in_mujoco):
    machine, other = in_mujoco
    assert other.model.neq == len(machine.closures) + len(machine.couplings)
    if other.data.ne:
        assert np.abs(other.data.efc_pos[: other.data.ne]).max() < 1e-6
    for _ in range(100):
        other.mujoco.mj_step(other.model, other.data)
    assert np.isfinite(other.data.qpos).all()
    if other.data.ne:
        assert np.abs(other.data.efc_pos[: other.data.ne]).max() < 1e-5


def drakes_frequencies(machine):
    """Natural frequencies of the machine on its drives, its loops closed [rad/s]."""
    plant, context = machine.plant, machine.context
    world, rows = plant.world_frame(), []

    def velocity(body, pose):
        place = pose.translation()[:, np.newaxis]
        return plant.CalcJacobianSpatialVelocity(
            context, JacobianWrtVariable.kV, body.body_frame(), place, world, world
        )

    names = dict(zip(machine.links, machine.bodies, strict=True))
    for closure in machine.closures:
        ends = zip(closure.links, closure.poses, strict=True)
        one, two = (velocity(names[link], pose) for link, pose in ends)
        rows.append((two - one)[0 if closure.kind == "weld" else 3 :])
    for coupling in machine.constraints.couplings:
        row = np.zeros((1, plant.num_velocities()))
        row[0, coupling.joint.velocity_start()] = 1.0
        row[0, coupling.leader.velocity_start()] = -coupling.ratio
        rows.append(row)
    free = null_space(np.vstack(rows), 1e-9) if rows else np.eye(plant.num_velocities())
    stiffness = np.zeros((plant.num_velocities(),) * 2)
    for actuator in machine.actuators.values():
        if actuator.has_controller():
            index = actuator.joint().velocity_start()
            stiffness[index, index] = actuator.get_controller_gains().p
    mass = plant.CalcMassMatrix(context)
    return np.sqrt(np.abs(eigh(free.T @ stiffness @ free, free.T @ mass @ free)[0]))


def mujocos_frequencies(other):
    model, data = other.model, other.data
    mass = np.zeros((model.nv, model.nv))
    for column, unit in zip(mass, np.eye(model.nv), strict=True):
        other.mujoco.mj_mulM(model, data, column, unit)
    stiffness = np.zeros_like(mass)
    for servo, (joint, _) in zip(model.actuator_biasprm, model.actuator_trnid, strict=True):
        index = model.jnt_dofadr[joint]
        stiffness[index, index] -= servo[1]
    jacobian, springs, added = other.springs()
    stiffness += jacobian.T @ (springs[:, np.newaxis] * jacobian)
    mass += jacobian.T @ (added[:, np.newaxis] * jacobian)
    return np.sqrt(np.abs(eigh(stiffness, mass)[0]))


def test_natural_frequencies_in_mujoco_are_drakes(in_mujoco):
    machine, other = in_mujoco
    one, two = drakes_frequencies(machine), mujocos_frequencies(other)
    np.testing.assert_allclose(two[: len(one)], one, rtol=_SOFT, atol=_STILL)
    assert one[-1] > 10.0 * _STILL, "no drive holds anything"


def test_a_file_moves_in_mujoco_as_the_machine_that_parapod_translates(in_mujoco):
    machine, other = in_mujoco
    constraints = machine.constraints
    if constraints.welds:
        pytest.skip("the second engine has no welds")
    own = MujocoModel(machine.plant, machine.scene_graph, constraints.balls, constraints.couplings)
    own.begin(machine.context)
    model, data = other.model, other.data
    is_touching = any(list(machine.shapes(body, Role.kProximity)) for body in machine.bodies)
    assert model.npair == own.model.npair
    assert bool(model.npair) == is_touching
    np.testing.assert_allclose(own.data.qpos, data.qpos, **_EXACT)
    own.data.ctrl[:] = model.actuator_gainprm[:, 0] * data.ctrl
    stands = (model.jnt_type == other.mujoco.mjtJoint.mjJNT_FREE).any()
    for _ in range(_STEPS if stands else _FALLS):
        other.mujoco.mj_step(model, data)
        own.step()
        np.testing.assert_allclose(data.qpos, own.data.qpos, atol=_APART)
    assert data.ncon == own.data.ncon
    if stands:  # as deep in the ground
        np.testing.assert_allclose(data.contact.dist, own.data.contact.dist, rtol=0.05)


def test_mujoco_bears_the_weight(in_mujoco):
    machine, other = in_mujoco
    floating = [joint for joint in machine.joints if isinstance(joint, QuaternionFloatingJoint)]
    if not floating or machine.constraints.welds:
        pytest.skip("stands on no ground")
    loads, wrench = [], np.zeros(6)
    for _ in range(_STEPS):
        other.mujoco.mj_step(other.model, other.data)
        loads.append(0.0)
        for i, contact in enumerate(other.data.contact):
            other.mujoco.mj_contactForce(other.model, other.data, i, wrench)
            loads[-1] += abs(wrench[:3] @ contact.frame.reshape(3, 3)[:, 2])
    moving = [body for body in machine.bodies[1:] if not machine.plant.IsAnchored(body)]
    weight = 9.81 * sum(body.get_mass(machine.context) for body in moving)
    assert np.mean(loads[_STEPS // 2 :]) == pytest.approx(weight, rel=0.01)


@pytest.mark.parametrize("suffix", ["urdf", "sdf", "xml"])
def test_a_command_writes_a_folder_that_can_be_moved(suffix, tmp_path, capsys):
    if suffix == "xml":
        mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    path = tmp_path / "one" / f"chair.{suffix}"
    path.parent.mkdir()
    assert main(["export", "chair-walk", "--out", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    counts = "43 links, 106.2 kg of which can move, 36 hinges and slides, 8 loops"
    assert lines[-1] == f"wrote {path}: {counts}"
    closed = any("8 ball joints close loops" in line and "loop_8_b at" in line for line in lines)
    assert closed == (suffix != "xml")
    text = path.read_text()
    assert all(line in text for line in lines if not line.startswith("wrote"))
    names = ["chair_meshes/lower_platform.obj", "chair_meshes/upper_platform.obj"]
    assert all(name in text for name in names)
    assert "/tmp" not in text
    assert sorted(str(f.relative_to(path.parent)) for f in path.parent.rglob("*.*")) == sorted(
        [path.name, *names]
    )
    moved = path.parent.rename(tmp_path / "two") / path.name
    if suffix == "xml":
        mujoco.MjModel.from_xml_path(str(moved))
        return
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    Parser(plant).AddModels(moved)


@pytest.mark.parametrize("form", ["urdf", "sdf", "mjcf"])
def test_a_line_tells_what_a_format_cannot_hold(form):
    machine, _, _ = built("machining_centre")
    lines = [line for line in notes(machine, form) if "the weld of" in line]
    assert len(lines) == (0 if form == "mjcf" else 3)
    for line, closure in zip(lines, machine.closures[3:], strict=False):
        for name, link in zip(closure.names, closure.links, strict=True):
            assert f"{name} at (" in line
            assert link in line


def test_parts_that_files_do_not_know_are_refused_and_leave_nothing(tmp_path):
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    one, two = (plant.AddRigidBody(name, inertia) for name in ("one", "two"))
    plant.AddJoint(WeldJoint("weld", plant.world_frame(), one.body_frame(), RigidTransform()))
    away = RigidTransform(np.array((0.1, 0.0, 0.0)))
    beside = plant.AddFrame(FixedOffsetFrame("beside", two.body_frame(), away))
    plant.AddJoint(RevoluteJoint("hinge", one.body_frame(), beside, [0.0, 0.0, 1.0]))
    plant.Finalize()
    machine = Description(plant, plant.CreateDefaultContext(), scene_graph, "machine")
    with pytest.raises(
        ParapodError, match=r"cannot write URDF: the hinge .* SDFormat and MJCF can"
    ):
        write_model(tmp_path / "machine.urdf", "urdf", machine)
    assert not list(tmp_path.iterdir())
    write_model(tmp_path / "machine.sdf", "sdf", machine)
    other = Loaded(machine, tmp_path / "machine.sdf")
    for angle in (0.0, 0.7):
        plant.SetPositions(machine.context, [angle])
        other.put([angle])
        poses = [
            each.EvalBodyPoseInWorld(context, each.GetBodyByName("two")).GetAsMatrix4()
            for each, context in ((plant, machine.context), (other.plant, other.context))
        ]
        np.testing.assert_allclose(poses[1], poses[0], **_EXACT)


def test_a_joint_of_another_kind_is_refused_by_name():
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    body = plant.AddRigidBody("body", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
    plant.AddJoint(BallRpyJoint("shoulder", plant.world_frame(), body.body_frame()))
    plant.Finalize()
    with pytest.raises(ParapodError, match="shoulder is a joint of a kind that files do not know"):
        Description(plant, plant.CreateDefaultContext(), scene_graph, "machine")


def test_shapes_and_inertias_that_no_machine_has_are_written_too(tmp_path):
    source = tmp_path / "own.obj"
    source.write_text(
        "mtllib own.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    (tmp_path / "own.mtl").write_text("newmtl grey\nKd 0.5 0.5 0.5\n")
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    flat = UnitInertia(0.1, 0.2, 0.3)
    inertia = SpatialInertia(1.0, np.zeros(3), flat)
    body = plant.AddRigidBody("body", inertia)
    skew = UnitInertia(0.2, 0.25, 0.3, 0.02, -0.03, 0.04)
    crooked = plant.AddRigidBody("crooked", SpatialInertia(2.0, np.array((0.1, 0.2, -0.1)), skew))
    shapes = Capsule(0.1, 0.3), Ellipsoid(0.1, 0.2, 0.3), Convex(str(source)), Mesh(str(source))
    for i, shape in enumerate(shapes):
        place = RigidTransform(np.array((0.1 * i, 0.0, 0.0)))
        plant.RegisterVisualGeometry(
            body, place, shape, f"shape {i}", np.array((0.1, 0.2, 0.3, 1.0))
        )
    plant.Finalize()
    machine = Description(plant, plant.CreateDefaultContext(), scene_graph, "machine")
    (tmp_path / "out").mkdir()
    for form in ("urdf", "sdf"):
        path = tmp_path / "out" / f"own.{form}"
        files = write_model(path, form, machine)
        assert [file.name for file in files] == ["own.obj", "own.mtl", path.name]
        other = Loaded(machine, path)
        copy = Description(other.plant, other.context, other.scene_graph, "copy")
        inertias = [
            each.CalcSpatialInertiaInBodyFrame(context).CopyToFullMatrix6()
            for each, context in (
                (crooked, machine.context),
                (other.body(crooked), other.context),
            )
        ]
        np.testing.assert_allclose(inertias[1], inertias[0], **_EXACT)
        again = list(copy.shapes(other.body(body), Role.kIllustration))
        wanted = list(machine.shapes(body, Role.kIllustration))
        if form == "urdf":
            wanted = [part for shape in wanted for part in parts_of(shape)]
        assert [type(each.shape) for each in again] == [type(each.shape) for each in wanted]
        for one, two in zip(wanted, again, strict=True):
            assert sizes(two.shape) == pytest.approx(sizes(one.shape))
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    model = InMujoco(machine, tmp_path / "out" / "own.xml").model
    assert model.ngeom == len(shapes)
    # Which refuses moments of inertia that rounding has made flatter than flat.
    text = (tmp_path / "out" / "own.urdf").read_text()
    flat_urdf = re.sub(r"<visual.*</visual>", "", text, flags=re.DOTALL)
    assert mujoco.MjModel.from_xml_string(flat_urdf).body_mass.sum() == pytest.approx(3.0)
