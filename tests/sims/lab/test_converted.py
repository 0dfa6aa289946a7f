"""Mechanisms in other formats: the same when they are read back, loops and motors kept."""

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from parapod.diagrams.any_mechanism.design import MechanismDesign
from parapod.sims.cli.main import main
from parapod.systems.mechanism.mechanism import Mechanism

mujoco: Any = pytest.importorskip("mujoco")

ROOT = Path(__file__).parents[3]
MODELS = ROOT / "tests" / "systems" / "mechanism" / "models"
FILES = {
    "hexapod": ROOT / "examples" / "mechanisms" / "hexapod" / "hexapod.urdf",
    "delta": ROOT / "examples" / "mechanisms" / "delta" / "delta.xml",
    "three_rps": MODELS / "three_rps.urdf",
    "four_bar": MODELS / "four_bar.sdf",
    "rod": MODELS / "rod.sdf",
    "welded": MODELS / "welded.xml",
}
FORMATS = {"urdf": ".urdf", "sdf": ".sdf", "mjcf": ".xml"}


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("name", FILES)
def test_a_mechanism_is_the_same_in_every_format(tmp_path, capsys, name, form):
    source, out = FILES[name], tmp_path / f"{name}{FORMATS[form]}"
    assert main(["convert", str(source), "--to", form, "--out", str(out)]) == 0
    assert "read back, links are where they were within" in capsys.readouterr().out
    before, after = Mechanism.load(source), Mechanism.load(out)
    assert after.mobility.freedoms == before.mobility.freedoms
    assert after.mobility.rank - after.mobility.equations == (
        before.mobility.rank - before.mobility.equations
    )
    # Motors lead the last link to the same place; names and order of motors are the same.
    names = [joint.name() for joint in before.motors]
    assert [joint.name() for joint in after.motors] == names
    way = 0.02 * np.random.default_rng(0).uniform(-1.0, 1.0, len(names))
    goal = before.motor_positions(before.home) + way
    poses = [m.forward(goal) for m in (before, after)]
    for link in ("platform", "coupler", "slider"):
        if before.plant.HasBodyNamed(link):
            places = [
                m.pose(link, q).translation() for m, q in zip((before, after), poses, strict=True)
            ]
            np.testing.assert_allclose(places[0], places[1], rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("form", FORMATS)
def test_a_joint_has_the_name_of_its_link_where_the_format_lets_it(tmp_path, capsys, form):
    source, out = tmp_path / "source.xml", tmp_path / f"out{FORMATS[form]}"
    # Its gear is a joint and a link; so is its shaft, which has the motor.
    source.write_text(
        FILES["welded"].read_text().replace('body name="crank"', 'body name="shaft"')
    )
    assert main(["convert", str(source), "--to", form, "--out", str(out)]) == 0
    others = {"shaft": "shaft_joint", "gear": "gear_joint"} if form == "sdf" else {}
    note = "joints have other names in SDFormat, as links have theirs: shaft is shaft_joint, gear"
    assert (note in capsys.readouterr().out) == bool(others)
    before, after = Mechanism.load(source), Mechanism.load(out)
    for joint in before.joints:
        if joint.num_velocities() == 1:
            assert after.joint(others.get(joint.name(), joint.name())).num_velocities() == 1
    (motor,) = after.motors
    assert motor.name() == others.get("shaft", "shaft")
    assert all(after.plant.HasBodyNamed(link) for link in ("shaft", "gear"))


# A trunk that floats, with a four-bar linkage whose loop is closed where all joints are at zero.
WALKER = """<mujoco model="walker">
  <option timestep="1e-3"/>
  <worldbody>
    <body name="trunk" pos="0.1 -0.2 0.7" quat="0.8 0 0.6 0">{base}
      <inertial pos="0.01 0 0.02" mass="5" diaginertia="0.1 0.2 0.3"/>
      <body name="crank" pos="0.1 0 0">
        <joint name="hip" axis="0 1 0" armature="0.02" damping="0.1" range="-60 60"/>
        <inertial pos="0 0 -0.1" mass="0.4" diaginertia="1e-3 1e-3 1e-3"/>
        <body name="rod" pos="0 0 -0.2">
          <joint name="knee" axis="0 1 0" armature="0.001"/>
          <inertial pos="0.1 0 0" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>
        </body>
      </body>
      <body name="rocker" pos="0.3 0 0">
        <joint name="rear" axis="0 1 0" stiffness="1.5" springref="20"/>
        <inertial pos="0 0 -0.1" mass="0.4" diaginertia="1e-3 1e-3 1e-3"/>
      </body>
      <body name="tail" pos="-0.2 0 0">
        <joint name="tail" axis="0 1 0" armature="0.03" actuatorfrcrange="-7 7"/>
        <inertial pos="-0.1 0 0" mass="0.5" diaginertia="2e-3 2e-3 2e-3"/>
      </body>
    </body>
  </worldbody>
  <equality><connect body1="rod" body2="rocker" anchor="0.2 0 0"/></equality>
  <actuator>
    {actuators}
  </actuator>
  <keyframe><key qpos="{key}"/></keyframe>
</mujoco>"""
SERVOS = """<position name="drive" joint="hip" kp="40" kv="2" gear="2" forcerange="-3 3"
      ctrlrange="-1 1"/>
    <position name="balance" joint="tail" kp="90" kv="1" forcerange="-8 6"/>"""


# Of other kinds, two on one joint, and limits of the joint itself.
OTHERS = """<velocity name="slow" joint="hip" kv="3"/>
    <motor name="push" joint="tail" gear="-3" ctrlrange="-2 2" armature="0.001"/>
    <general name="lean" joint="tail" gainprm="4" biastype="affine" biasprm="1 -20 -3"
      forcerange="-9 9"/>"""


def walker(path, actuators=SERVOS, base="<freejoint name='float'/>"):
    """Writes the walker, and returns its file."""
    key = "1 2 3 1 0 0 0 0 0 0 0" if base else "0 0 0 0"
    path.write_text(WALKER.format(actuators=actuators, base=base, key=key))
    return path


def test_a_base_that_floats_is_where_it_was_without_the_key_frame(tmp_path, capsys):
    source, out = walker(tmp_path / "source.xml"), tmp_path / "out.xml"
    assert main(["convert", str(source), "--to", "mjcf", "--out", str(out)]) == 0
    poses = [mujoco.MjModel.from_xml_path(str(path)).qpos0 for path in (source, out)]
    np.testing.assert_allclose(poses[1], poses[0], rtol=0.0, atol=1e-9)
    homes = [m.pose("trunk", m.home).GetAsMatrix4() for m in map(Mechanism.load, (source, out))]
    np.testing.assert_allclose(homes[1], homes[0], rtol=0.0, atol=1e-9)
    # URDF holds neither, SDFormat the pose alone.
    capsys.readouterr()
    for form in ("urdf", "sdf"):
        out = tmp_path / f"out.{form}"
        assert main(["convert", str(source), "--to", form, "--out", str(out)]) == 0
        lines = capsys.readouterr().out
        assert "that trunk is free; --free reads it back so" in lines
        assert ("the pose of trunk is not in URDF" in lines) == (form == "urdf")
        freedoms = [Mechanism.load(out, is_free=free).mobility.freedoms for free in (None, True)]
        assert freedoms == [2, 8]
        if form == "sdf":
            other = Mechanism.load(out, is_free=True)
            pose = other.pose("trunk", other.home).GetAsMatrix4()
            np.testing.assert_allclose(pose, homes[0], rtol=0.0, atol=1e-9)
    base = tmp_path / "welded.xml"
    capsys.readouterr()
    arguments = ["convert", str(walker(base, base="")), "--to", "urdf"]
    assert main([*arguments, "--out", str(tmp_path / "welded.urdf")]) == 0
    assert "--free" not in capsys.readouterr().out


def mjcf_of(source, folder):
    """A file, converted; both as MuJoCo loads them."""
    out = folder / "converted.xml"
    assert main(["convert", str(source), "--to", "mjcf", "--out", str(out)]) == 0
    return [mujoco.MjModel.from_xml_path(str(path)) for path in (source, out)]


@pytest.mark.parametrize("actuators", [SERVOS, OTHERS])
def test_a_converted_mjcf_has_the_drives_of_its_source(tmp_path, actuators):
    source, out = mjcf_of(walker(tmp_path / "source.xml", actuators), tmp_path)
    for what in ("gainprm", "biasprm", "gear", "forcelimited", "forcerange", "ctrllimited"):
        parts = [getattr(model, f"actuator_{what}") for model in (source, out)]
        np.testing.assert_array_equal(parts[1], parts[0])
    np.testing.assert_array_equal(out.actuator_ctrlrange, source.actuator_ctrlrange)
    for i in range(source.nu):
        assert out.actuator(i).name == source.actuator(i).name
    for name in ("hip", "knee", "rear", "tail"):
        joints = [model.joint(name) for model in (source, out)]
        for what in ("stiffness", "damping"):
            one, two = (np.ravel(getattr(joint, what))[0] for joint in joints)
            assert two == one
        ranges = [
            model.jnt_actfrcrange[joint.id]
            for model, joint in zip((source, out), joints, strict=True)
        ]
        np.testing.assert_array_equal(ranges[1], ranges[0])
    before, after = (Mechanism.load(tmp_path / name) for name in ("source.xml", "converted.xml"))
    for joint in before.joints:
        if joint.num_velocities() == 1:
            assert limits(after, after.joint(joint.name())) == limits(before, joint)
    masses = [m.plant.CalcMassMatrix(m.plant.CreateDefaultContext()) for m in (before, after)]
    np.testing.assert_allclose(masses[1], masses[0], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("actuators", "control"),
    [(SERVOS, (0.0, 0.0)), (SERVOS, (2.0, -0.8)), (OTHERS, (0.2, 0.5, 0.3))],
)
def test_a_converted_mjcf_moves_and_holds_in_mujoco_as_its_source(tmp_path, actuators, control):
    source, out = mjcf_of(walker(tmp_path / "source.xml", actuators, base=""), tmp_path)
    ways, forces = [], []
    for model in (source, out):
        model.opt.timestep = 1e-4  # short enough for either integrator
        data = mujoco.MjData(model)
        data.ctrl[:] = control
        for _ in range(10):
            mujoco.mj_step(model, data, 1000)
            ways.append(data.qpos.copy())
            forces.append(data.qfrc_actuator.copy())
    ways, forces = (np.array(of).reshape(2, 10, -1) for of in (ways, forces))
    # Loops of the source are soft, and motors swing by as much as 1.4 rad.
    np.testing.assert_allclose(ways[1], ways[0], rtol=0.0, atol=5e-3)
    np.testing.assert_allclose(forces[1][-1], forces[0][-1], rtol=0.0, atol=0.05)


@pytest.mark.parametrize("form", ["urdf", "sdf"])
def test_gains_and_limits_of_servos_go_through_formats_of_joints(tmp_path, capsys, form):
    source = walker(tmp_path / "source.xml")
    middle, out = tmp_path / f"middle.{form}", tmp_path / "out.xml"
    assert main(["convert", str(source), "--to", form, "--out", str(middle)]) == 0
    lines = capsys.readouterr().out
    assert "2 servos, as drake:controller_gains" in lines
    for what, names in (("gears", "hip"), ("ranges of controls", "hip"), ("armatures", "knee")):
        assert f": the {what} of {names}\n" in lines
    assert main(["convert", str(middle), "--free", "--to", "mjcf", "--out", str(out)]) == 0
    assert "2 position servos, control a position; 2 limits of force; 2 armatures" in (
        capsys.readouterr().out
    )
    models = [mujoco.MjModel.from_xml_path(str(path)) for path in (source, out)]
    assert models[1].nu == 2
    for i, (gear, largest) in enumerate(((2.0, 3.0), (1.0, 7.0))):
        drive, servo = (model.actuator(i) for model in models)
        # Of the joint, as it feels them through the gear.
        np.testing.assert_allclose(servo.gainprm, gear**2 * drive.gainprm, rtol=1e-12)
        np.testing.assert_allclose(servo.biasprm, gear**2 * drive.biasprm, rtol=1e-12)
        np.testing.assert_allclose(servo.forcerange, gear * largest * np.array((-1, 1)))
        joints = [model.joint(model.actuator(i).trnid[0]) for model in models]
        assert joints[1].armature[0] == pytest.approx(joints[0].armature[0], rel=1e-12)


def test_a_source_without_gains_has_motors_whose_controls_are_forces(tmp_path, capsys):
    out = tmp_path / "hexapod.xml"
    assert main(["convert", str(FILES["hexapod"]), "--to", "mjcf", "--out", str(out)]) == 0
    line = "drives in MJCF: 6 motors, control a force, for want of gains; 6 limits of force"
    assert line in capsys.readouterr().out
    assert line in out.read_text()
    model = mujoco.MjModel.from_xml_path(str(out))
    assert (model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE).all()
    np.testing.assert_array_equal(model.actuator_gainprm[:, 0], 1.0)
    np.testing.assert_array_equal(model.actuator_forcerange, 6 * [[-2000.0, 2000.0]])
    assert model.actuator_forcelimited.all()


def test_an_actuator_that_is_more_than_a_servo_is_named_and_becomes_a_motor(tmp_path, capsys):
    lazy = '<position name="lazy" joint="hip" kp="4" timeconst="0.1" forcerange="-2 2" gear="3"/>'
    _, out = mjcf_of(walker(tmp_path / "source.xml", lazy), tmp_path)
    lines = capsys.readouterr().out
    assert (
        "not read: the force of the actuator lazy, which is more than a gain and a bias" in lines
    )
    assert "1 motor, control a force, for want of gains; 1 limit of force" in lines
    assert out.nu == 1
    np.testing.assert_array_equal(out.actuator_forcerange, [[-6.0, 6.0]])


def limits(mechanism, joint):
    """Limits of a joint and its motor."""
    actuators = map(mechanism.plant.get_joint_actuator, mechanism.plant.GetJointActuatorIndices())
    sides = ("lower", "upper")
    return {
        "position": [*(getattr(joint, f"position_{side}_limits")()[0] for side in sides)],
        "velocity": [*(getattr(joint, f"velocity_{side}_limits")()[0] for side in sides)],
        "effort": [a.effort_limit() for a in actuators if a.joint().index() == joint.index()],
    }


@pytest.mark.parametrize("form", ["urdf", "sdf"])
@pytest.mark.parametrize("name", ["delta", "three_rps", "four_bar", "limited"])
def test_limits_are_the_same_and_there_are_none_where_there_were_none(tmp_path, name, form):
    source, out = FILES.get(name), tmp_path / f"out.{form}"
    if source is None:  # one motor with limits of all kinds, and one without a transmission
        text = FILES["hexapod"].read_text()
        ends = 'effort="7" velocity="0.3"/>'
        source = tmp_path / "limited.urdf"
        source.write_text(re.sub(r'effort="[^"]*" velocity="[^"]*"/>', ends, text, count=1))
        shutil.copy(FILES["hexapod"].with_suffix(".yaml"), tmp_path / "limited.yaml")
    assert main(["convert", str(source), "--to", form, "--out", str(out)]) == 0
    before, after = Mechanism.load(source), Mechanism.load(out)
    for joint in before.joints:
        if joint.num_velocities() == 1:
            one, two = limits(before, joint), limits(after, after.joint(joint.name()))
            assert two == one
            assert two["velocity"] == [-two["velocity"][1], two["velocity"][1]]
    machines = [MechanismDesign(file=str(path)).built.motors for path in (source, out)]
    assert machines[1].velocities == machines[0].velocities
    assert machines[1].forces == machines[0].forces


def test_a_converted_mjcf_stands_in_mujoco_with_its_loops_closed(tmp_path):
    out = tmp_path / "hexapod.xml"
    assert main(["convert", str(FILES["hexapod"]), "--to", "mjcf", "--out", str(out)]) == 0
    model = mujoco.MjModel.from_xml_path(str(out))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("standing").id)
    mujoco.mj_forward(model, data)
    assert model.neq == 5
    assert np.abs(data.efc_pos[: 3 * model.neq]).max() < 1e-9


def test_conversions_side_by_side_do_not_take_each_other_s_loops(tmp_path):
    for file in FILES["hexapod"].parent.iterdir():
        shutil.copy(file, tmp_path)
    before = (tmp_path / "hexapod.yaml").read_text()
    for form, suffix in FORMATS.items():
        source, out = tmp_path / "hexapod.urdf", tmp_path / f"hexapod{suffix}"
        if form != "urdf":
            assert main(["convert", str(source), "--to", form, "--out", str(out)]) == 0
            assert Mechanism.load(out).mobility.equations == 15
    assert (tmp_path / "hexapod.yaml").read_text() == before
    assert Mechanism.load(tmp_path / "hexapod.urdf").mobility.equations == 15


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--to", "mjcf", "--out", "a.urdf"], "the suffix of MJCF must be one of .mjcf, .xml"),
        (["--to", "sdf", "--out", "none/a.sdf"], "none"),
        (["--to", "usd"], "invalid choice: 'usd'"),
    ],
)
def test_mistakes_are_refused_in_a_line(capsys, tmp_path, monkeypatch, words, line):
    monkeypatch.chdir(tmp_path)
    assert main(["convert", str(FILES["delta"]), *words]) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_what_is_read_is_not_written_over(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("hexapod.urdf", "hexapod.yaml"):
        shutil.copy(FILES["hexapod"].with_name(name), tmp_path)
    (tmp_path / "link.urdf").symlink_to("hexapod.urdf")
    shutil.copy(FILES["delta"], tmp_path / "delta.xml")
    shutil.copy(tmp_path / "hexapod.yaml", tmp_path / "other.sdf.yaml")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    for words, name in (
        (["delta.xml", "--to", "mjcf"], "delta.xml"),
        ([str(tmp_path / "delta.xml"), "--to", "mjcf"], "delta.xml"),
        (
            ["delta.xml", "--to", "mjcf", "--out", "../" + tmp_path.name + "/delta.xml"],
            "delta.xml",
        ),
        (["hexapod.urdf", "--to", "urdf"], "hexapod.urdf"),
        (["hexapod.urdf", "--to", "urdf", "--out", "link.urdf"], "link.urdf"),
        (
            ["hexapod.urdf", "--loops", "other.sdf.yaml", "--to", "sdf", "--out", "other.sdf"],
            "other.sdf.yaml",
        ),
    ):
        assert main(["convert", *words]) == 2
        error = capsys.readouterr().err
        assert name in error
        assert "--out" in error
        assert error.count("\n") == 1
        assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
