"""A translated plant is the plant: inertias, poses, forces and springs of both engines."""

import sys

import numpy as np
import pytest
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from parapod.diagrams.levelling_platform.model import add_platform
from parapod.diagrams.walking_chair.model import add_chair
from parapod.systems.core.errors import MissingExtra, WiringError
from parapod.systems.levelling_platform.geometry import LegDeviation, PlatformGeometry
from parapod.systems.physics.mujoco.model import MujocoModel
from parapod.systems.physics.mujoco.translation import joint_name
from parapod.systems.walking_chair.masses import Passenger

mujoco = pytest.importorskip("mujoco")
STEP = 1e-3
BUILT = PlatformGeometry(
    foot_radius=0.025, deviations=(LegDeviation(l_3=1e-3, l_4=-2e-3, beta=3e-3),) * 4
)


class Machine:
    """A plant, its translation, and a context at a random configuration."""

    def __init__(self, add, step=STEP, **told):
        self.plant, self.scene_graph = MultibodyPlant(step), SceneGraph()
        self.plant.RegisterAsSourceForSceneGraph(self.scene_graph)
        self.machine = add(self.plant)
        named = {"balls": self.machine.balls, "feet": feet_of(self.machine)}
        named["couplings"] = getattr(self.machine, "couplings", ())
        self.translated = MujocoModel(self.plant, self.scene_graph, **named | told)
        self.context = self.plant.CreateDefaultContext()

    @property
    def floating(self):
        (body,) = (self.plant.get_body(i) for i in self.plant.GetFloatingBaseBodies())
        return body

    def scatter(self, random):
        """Any positions and velocities: both engines are asked for what needs no closed loops."""
        q = random.uniform(-1.0, 1.0, self.plant.num_positions())
        start = self.floating.floating_positions_start()
        q[start : start + 4] /= np.linalg.norm(q[start : start + 4])
        self.plant.SetPositions(self.context, q)
        v = random.uniform(-1.0, 1.0, self.plant.num_velocities())
        self.plant.SetVelocities(self.context, v)
        state = self.translated.begin(self.context)
        self.translated.write_state(state)
        mujoco.mj_forward(self.translated.model, self.translated.data)
        return state

    def changed(self, tau):
        """Generalized forces of the plant in MuJoCo's order and frames."""
        model = self.translated.model
        moved = np.zeros(model.nv)
        for i in range(model.nv):
            velocity = np.zeros(model.nv)
            velocity[i] = 1.0
            moved[i] = tau @ self.to_plant(velocity)
        return moved

    def to_plant(self, velocity):
        """Velocities of the plant for those of MuJoCo at the configuration."""
        state = self.translated.read_state()
        model = self.translated.model
        state[1 + model.nq : 1 + model.nq + model.nv] = velocity
        return self.translated.plant_state(state)[self.plant.num_positions() :]


def feet_of(machine):
    return machine.feet if hasattr(machine, "feet") else machine.leg_bodies("roller")


MACHINES = {
    "platform": add_platform,
    "reduced": lambda plant: add_platform(plant, "reduced", "rolling", (0.02, -0.05)),
    "built": lambda plant: add_platform(plant, geometry=BUILT, foot_offsets=(5e-3, 0, -2e-3, 0)),
    "chair": add_chair,
    "empty chair": lambda plant: add_chair(plant, Passenger(0.0)),
}


@pytest.fixture(params=list(MACHINES))
def machine(request):
    return Machine(MACHINES[request.param])


def test_states_go_from_one_engine_to_the_other_and_back(machine):
    random = np.random.default_rng(1)
    state = machine.scatter(random)
    wanted = machine.plant.GetPositionsAndVelocities(machine.context)
    np.testing.assert_allclose(machine.translated.plant_state(state), wanted, atol=1e-15)


def test_both_have_the_same_inertia_weight_and_poses(machine):
    random = np.random.default_rng(2)
    for _ in range(3):
        machine.scatter(random)
        model, data = machine.translated.model, machine.translated.data
        velocities = np.eye(model.nv)
        columns = []
        for velocity in velocities:
            mujoco.mj_mulM(model, data, column := np.zeros(model.nv), velocity)
            columns.append(column)
        mass = machine.plant.CalcMassMatrix(machine.context)
        turned = np.array([machine.to_plant(velocity) for velocity in velocities])
        np.testing.assert_allclose(np.array(columns), turned @ mass @ turned.T, atol=1e-12)
        weight = machine.changed(machine.plant.CalcGravityGeneralizedForces(machine.context))
        data.qvel[:] = 0.0
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(-data.qfrc_bias, weight, atol=1e-11)
        for i, pose in enumerate(machine.translated.poses()):
            body = machine.plant.get_body(BodyIndex(i))
            wanted = machine.plant.EvalBodyPoseInWorld(machine.context, body)
            assert pose.IsNearlyEqualTo(wanted, 1e-13), body.name()


def test_joints_and_drives_have_the_same_limits_damping_and_gains(machine):
    model, damped = machine.translated.model, 0
    for i in machine.plant.GetJointIndices():
        joint = machine.plant.get_joint(i)
        if joint.num_positions() != 1:
            continue
        found = model.joint(joint_name(joint))
        assert found.damping == joint.GetDampingVector(machine.context)
        damped += found.damping[0] > 0.0
        limits = [joint.position_lower_limits()[0], joint.position_upper_limits()[0]]
        assert bool(model.jnt_limited[found.id]) == bool(np.isfinite(limits).all())
        if model.jnt_limited[found.id]:
            assert found.range.tolist() == limits
    assert damped or hasattr(machine.machine, "feet")  # rollers are damped, the chair's feet not
    assert model.nu == machine.plant.num_actuators()
    for i in machine.plant.GetJointActuatorIndices():
        drive = machine.plant.get_joint_actuator(i)
        gains = drive.get_controller_gains()
        found = model.actuator(joint_name(drive.joint()))
        assert (found.gainprm[0], *found.biasprm[:3]) == (1.0, 0.0, -gains.p, -gains.d)


def test_another_passenger_is_as_one_that_was_there_from_the_start():
    heavy, light = Passenger(80.0, 0.05, -0.03, 0.4), Passenger(30.0)

    def chair(passenger):
        made = Machine(lambda plant: add_chair(plant, passenger))
        loads = (made.machine.passenger,)
        made.translated = MujocoModel(
            made.plant, made.scene_graph, made.machine.balls, loads=loads
        )
        return made

    one, other = chair(heavy), chair(light)
    other.machine.seat(other.context, heavy)
    other.translated.set_loads(other.translated.loads_of(other.context))
    for name in ("body_mass", "body_inertia", "body_ipos", "body_pos", "body_invweight0"):
        one_array, other_array = (getattr(m.translated.model, name) for m in (one, other))
        np.testing.assert_allclose(other_array, one_array, atol=1e-14, err_msg=name)


def test_constraints_that_are_not_told_are_refused():
    with pytest.raises(WiringError, match="the plant has 8 constraints, but only 4 are given"):
        Machine(add_platform, balls=())


def test_without_mujoco_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingExtra, match=r'^mujoco is needed .*pip install "parapod\[mujoco\]"'):
        Machine(add_platform)


def test_what_is_not_finite_is_told_and_seen_and_writes_no_file(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    made = Machine(add_chair)
    state = made.translated.begin(made.context)
    state[1] = np.nan
    made.translated.write_state(state)
    made.translated.step()
    assert "Nan, Inf or huge value in QPOS at DOF 0" in caplog.text
    assert np.isnan(made.translated.read_state()[1])
    assert list(tmp_path.iterdir()) == []


# Springs


@pytest.mark.parametrize("step", [5e-4, 2e-3])
def test_feet_sink_in_by_their_weight_over_the_contacts_stiffness(step):
    """A contact is Drake's spring at any step: 5e7 N/m of foot and of ground in a row."""
    made = Machine(add_platform, step)
    positions = made.machine.standing_positions([0.405] * 4, (0.0, 0.0))
    made.plant.SetPositions(made.context, positions)
    translated = made.translated
    translated.write_state(translated.begin(made.context))
    data = translated.data
    drives = [made.plant.get_joint_actuator(i) for i in made.plant.GetJointActuatorIndices()]
    for i, drive in enumerate(drives):
        at, _ = translated.index_of(drive.joint())
        data.ctrl[i] = drive.get_controller_gains().p * data.qpos[at]
    for _ in range(round(0.4 / step)):
        translated.step()
    assert data.ncon == 4
    depth, force = -data.contact.dist, data.sensordata
    np.testing.assert_allclose(depth, force / 2.5e7, rtol=2e-3)
    ground = made.plant.GetBodyByName("ground").get_mass(made.context)
    weight = 9.81 * (made.plant.CalcTotalMass(made.context) - ground)
    assert force.sum() == pytest.approx(weight, rel=1e-5)
    # Loops: rods of 700 N, 1e10 N/m.
    gaps = data.efc_pos[:12].reshape(4, 3)
    assert np.linalg.norm(gaps, axis=1).max() < 2e-7


def test_a_constraint_is_the_implicit_spring_that_the_translation_takes_it_for():
    """f = -(a + b v' + k (r + h v')) / R, on a mass that an equality constraint holds."""
    stiffness, damping, regularization, mass, step = 4e4, 30.0, 2.0, 3.0, 1e-3
    impedance = 1.0 / (1.0 + regularization)
    model = mujoco.MjModel.from_xml_string(f"""
      <mujoco><option timestep="{step}" integrator="discrete" gravity="0 0 -9.81"/>
        <worldbody><body><joint name="x" type="slide" axis="0 0 1"/>
          <geom type="sphere" size=".1" mass="{mass}"/></body></worldbody>
        <equality><joint joint1="x" solref="{-stiffness * impedance} {-damping * impedance}"
          solimp="{impedance} {impedance} 1"/></equality></mujoco>""")
    model.dof_invweight0[:] = 1.0
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = x, v = 0.01, -0.2
    for _ in range(5):
        held = 1.0 / regularization + step * (damping + step * stiffness) / regularization
        pull = (damping * v + stiffness * (x + step * v)) / regularization
        acceleration = (-9.81 * mass - pull) / (mass + held)
        v += step * acceleration
        x += step * v
        mujoco.mj_step(model, data)
        assert data.qpos[0] == pytest.approx(x, rel=1e-9)
        assert data.qvel[0] == pytest.approx(v, rel=1e-9)
