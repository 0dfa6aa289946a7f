"""Model files of mechanisms: what is read, how loops are cut, and what is refused in a line."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from parapod.systems.core.errors import ScenarioError
from parapod.systems.mechanism.equations import UnsolvedPose
from parapod.systems.mechanism.mechanism import Mechanism
from tests.systems.mechanism.conftest import MECHANISMS, MODELS

mujoco: Any = pytest.importorskip("mujoco")

ARM = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link>
  <link name="lower"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link>
  <link name="end"/>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="1 0 0"/><axis xyz="0 1 0"/></joint>
  <joint name="hand" type="fixed"><parent link="lower"/><child link="end"/>
    <origin xyz="1 0 0"/></joint>
  <link name="goal"/>
  <joint name="rail" type="prismatic"><parent link="base"/><child link="goal"/>
    <origin xyz="1.9 0 0"/><axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="1"/></joint>
  {more}
</robot>"""


def write(folder: Path, loops: str, more: str = "", name: str = "arm.urdf") -> Path:
    path = folder / name
    path.write_text(ARM.replace("{more}", more))
    if loops:
        (folder / "arm.yaml").write_text(loops)
    return path


def test_a_loop_beside_a_urdf_closes_it(tmp_path):
    path = write(tmp_path, "closed_loop: [[end, goal]]\ntype: [3d]\nname_mot: [rail]\n")
    mechanism = Mechanism.load(path)
    bend = mechanism.joint("elbow").position_start()
    bent = mechanism.solve(near=mechanism.positions({"shoulder": -0.3, "elbow": 0.6}))
    assert bent.is_closed
    q = mechanism.forward([-0.5], near=bent.q)
    # A triangle of sides 1, 1 and 1.4.
    assert abs(q[bend]) == pytest.approx(np.pi - 2.0 * np.arcsin(0.7), abs=1e-9)
    assert mechanism.mobility.redundant == {"end - goal": 1}


def test_a_range_of_a_whole_turn_is_no_limit_of_a_hinge_without_a_motor(tmp_path):
    path = write(tmp_path, "closed_loop: [[end, goal]]\ntype: [3d]\nname_mot: [rail]\n")
    whole = '<limit lower="0" upper="6.2832" effort="1" velocity="1"/>'
    text = path.read_text().replace('type="continuous"', 'type="revolute"')
    path.write_text(text.replace('<axis xyz="0 1 0"/>', f'<axis xyz="0 1 0"/>{whole}'))
    mechanism = Mechanism.load(path)
    assert "limits of a whole turn count as none: shoulder, elbow" in mechanism.notes
    assert mechanism.is_within_limits(mechanism.positions({"shoulder": -0.3, "elbow": 7.0}))


def test_a_loop_may_hold_points_of_links_together(tmp_path):
    loops = "closed_loop: [[lower, goal]]\ntype: [3d]\npoints: [[[1, 0, 0], [0, 0, 0]]]\n"
    by_points = Mechanism.load(write(tmp_path, loops + "name_mot: [rail]\n"))
    (tmp_path / "other").mkdir()
    loops = "closed_loop: [[end, goal]]\ntype: [3d]\nname_mot: [rail]\n"
    by_frames = Mechanism.load(write(tmp_path / "other", loops))
    q = np.array([-0.3, 0.6, 0.1])
    np.testing.assert_allclose(by_points.residual(q), by_frames.residual(q), atol=1e-15)


def test_a_joint_that_mimics_another_is_a_loop(tmp_path):
    more = """<link name="gear"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"
      ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="turn" type="continuous"><parent link="base"/><child link="gear"/>
      <axis xyz="0 1 0"/><mimic joint="shoulder" multiplier="-2" offset="0.1"/></joint>"""
    mechanism = Mechanism.load(write(tmp_path, "", more), motors=["shoulder"])
    q = mechanism.forward([0.3], near=mechanism.home)
    assert q[mechanism.joint("turn").position_start()] == pytest.approx(-0.5, abs=1e-12)


def test_rods_of_a_urdf_are_loops(tmp_path):
    more = """<drake:distance_constraint xmlns:drake="http://drake.mit.edu">
      <drake:distance_constraint_body_A name="end"/><drake:distance_constraint_body_B name="goal"/>
      <drake:distance_constraint_p_AP value="0 0 0"/>
      <drake:distance_constraint_p_BQ value="0 0 0"/>
      <drake:distance_constraint_distance value="0.3"/>
      <drake:distance_constraint_stiffness value="1e9"/>
      <drake:distance_constraint_damping value="0"/></drake:distance_constraint>"""
    mechanism = Mechanism.load(write(tmp_path, "", more), motors=["shoulder", "rail"])
    q = mechanism.forward([0.2, -0.1])
    ends = [mechanism.pose(name, q).translation() for name in ("end", "goal")]
    assert np.linalg.norm(ends[0] - ends[1]) == pytest.approx(0.3, abs=1e-12)
    rows, is_closed = mechanism.forward_rows([[0.2, -0.1]])
    assert is_closed.all()
    np.testing.assert_allclose(rows[0], q, atol=1e-9)


@pytest.mark.parametrize(
    ("loops", "line"),
    [
        ("closed_loop: [[end, gaol]]\ntype: [3d]\n", r"no frame 'gaol' \(did you mean goal\?\)"),
        ("closed_loop: [[end, goal]]\ntype: [4d]\n", "type '4d' is not one of 3d, 6d"),
        ("closed_loop: [[end, goal]]\ntype: []\n", "closed_loop has 1 entries and type 0"),
        ("closed_loop: [[end]]\ntype: [3d]\n", "closed_loop has 1 frames in place of two"),
        (
            "closed_loop: [[end, goal]]\ntype: [3d]\npoints: [[[0, 0], [0, 0, 0]]]\n",
            "of points is not two points of three numbers",
        ),
        ("closed_loop: [[end, goal]]\ntype: [3d]\npoints: [[], []]\n", "1 entries and points 2"),
        ("name_mot: [railway]\n", r"no joint 'railway' \(did you mean rail\?\)"),
        ("joint_name: [elbow]\njoint_type: [UJOINT_XX]\n", "'UJOINT_XX' of 'elbow' is not one of"),
        (
            "joint_name: [elbow]\njoint_type: [SPHERICAL]\nname_mot: [elbow]\n",
            "joint elbow cannot have a motor: it has more than one freedom",
        ),
        ("closed_lop: []\n", "closed_lop"),
    ],
)
def test_what_a_file_of_loops_names_wrongly_is_refused_in_a_line(tmp_path, loops, line):
    with pytest.raises(ScenarioError, match=line) as caught:
        Mechanism.load(write(tmp_path, loops))
    assert "\n" not in str(caught.value)


def test_a_loop_that_cannot_close_says_which_and_by_how_much(tmp_path):
    more = """<link name="far"/><joint name="away" type="fixed"><parent link="base"/>
      <child link="far"/><origin xyz="0 0 2.5"/></joint>"""
    path = write(tmp_path, "closed_loop: [[end, far]]\ntype: [3d]\n", more)
    mechanism = Mechanism.load(path)
    with pytest.raises(UnsolvedPose, match="missed end - far by 500 mm") as caught:
        _ = mechanism.home
    assert caught.value.gaps[0].length == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("name", "text", "line"),
    [
        ("none.urdf", None, "no such file"),
        ("model.stl", "solid", "the suffix of a model is one of .urdf, .sdf, .xml"),
        ("broken.urdf", "<robot", "cannot read"),
        ("broken.xml", "<mujoco", "cannot read"),
        (
            "tendon.xml",
            '<mujoco><worldbody><body name="a"><joint name="j"/><geom size="1"/></body>'
            '</worldbody><tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon>'
            '<equality><tendon tendon1="t"/></equality></mujoco>',
            "an equality of the kind tendon; connect, weld, joint and tendons as rods are",
        ),
        (
            "curve.xml",
            '<mujoco><worldbody><body><joint name="j"/><geom size="1"/><body><joint name="k"/>'
            '<geom size="1"/></body></body></worldbody><equality><joint joint1="j" joint2="k" '
            'polycoef="0 1 1 0 0"/></equality></mujoco>',
            "couples joints by more than a ratio and an offset",
        ),
    ],
)
def test_files_that_cannot_be_read_are_refused_in_a_line(tmp_path, name, text, line):
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(ScenarioError, match=line) as caught:
        Mechanism.load(path)
    assert "\n" not in str(caught.value)


UNLIKE = """<mujoco model="unlike">
  <compiler angle="degree"/>
  <default><joint damping="0.1"/></default>
  <worldbody>
    <body name="a" pos="0.1 0.2 0.3" euler="10 20 30">
      <joint name="ref" type="hinge" axis="0 1 1" pos="0.1 0 0" ref="30" range="-90 90"/>
      <geom type="box" size="0.1 0.2 0.3" mass="2" pos="0.1 0 0" euler="0 40 0"/>
      <body pos="0.5 0 0">
        <joint name="first" type="hinge" axis="1 0 0"/>
        <joint name="second" type="slide" axis="0 1 0" ref="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.3 0.1 0" size="0.05" mass="1"/>
        <site name="end" pos="0.3 0.1 0" euler="0 0 50"/>
      </body>
    </body>
    <body name="c" pos="0 1 0">
      <freejoint name="float"/>
      <geom type="ellipsoid" size="0.1 0.2 0.3" mass="3"/>
      <site name="middle"/>
    </body>
  </worldbody>
  <equality><weld site1="end" site2="middle"/></equality>
  <actuator><motor name="drive" joint="ref" gear="5"/></actuator>
</mujoco>"""


def test_an_mjcf_has_the_poses_and_masses_that_mujoco_gives_it(tmp_path):
    path = tmp_path / "unlike.xml"
    path.write_text(UNLIKE)
    files = (path, MECHANISMS / "delta" / "delta.xml")
    for each in files:
        mechanism = Mechanism.load(each)
        model = mujoco.MjModel.from_xml_path(str(each))
        data, plant = mujoco.MjData(model), mechanism.plant
        random, context = np.random.default_rng(0), plant.CreateDefaultContext()
        q = plant.GetPositions(context)
        for joint in range(model.njnt):
            if model.jnt_type[joint] in (2, 3):  # slides and hinges
                value = random.uniform(-1.0, 1.0)
                data.qpos[model.jnt_qposadr[joint]] = value
                q[mechanism.joint(model.joint(joint).name).position_start()] = value
        mujoco.mj_kinematics(model, data)
        plant.SetPositions(context, q)
        for body in range(1, model.nbody):
            name = model.body(body).name or f"body_{body}"
            pose = plant.GetBodyByName(name).EvalPoseInWorld(context)
            np.testing.assert_allclose(pose.translation(), data.xpos[body], atol=1e-12)
            turn = pose.rotation().matrix().ravel()
            np.testing.assert_allclose(turn, data.xmat[body], atol=1e-12)
            link = plant.GetBodyByName(name)
            assert link.default_mass() == pytest.approx(model.body_mass[body], rel=1e-12)
            np.testing.assert_allclose(link.default_com(), model.body_ipos[body], atol=1e-12)
        assert plant.CalcTotalMass(context) == pytest.approx(model.body_mass.sum(), rel=1e-12)
        assert [joint.name() for joint in mechanism.motors] == [
            model.joint(model.actuator(i).trnid[0]).name for i in range(model.nu)
        ]


def test_what_an_mjcf_includes_is_beside_it_wherever_it_is_read(tmp_path, monkeypatch):
    _, body = UNLIKE.split("<default>")
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "robot.xml").write_text(f"<mujoco><default>{body}")
    scene = '<mujoco><compiler angle="degree"/><include file="parts/robot.xml"/></mujoco>'
    (tmp_path / "scene.xml").write_text(scene)
    whole = tmp_path / "unlike.xml"
    whole.write_text(UNLIKE)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    homes = [Mechanism.load(path).home for path in (whole, "../scene.xml")]
    np.testing.assert_array_equal(*homes)


def test_loops_of_an_mjcf_are_closed_where_mujoco_has_them_closed(tmp_path):
    path = tmp_path / "unlike.xml"
    path.write_text(UNLIKE)
    mechanism = Mechanism.load(path)
    assert mechanism.mobility.freedoms == 3
    q = mechanism.home
    model = mujoco.MjModel.from_xml_path(str(path))
    data, (start,) = mujoco.MjData(model), [mechanism.plant.GetBodyByName("c")]
    for joint in range(model.njnt):
        name = model.joint(joint).name
        if name != "float":
            data.qpos[model.jnt_qposadr[joint]] = q[mechanism.joint(name).position_start()]
    first, place = start.floating_positions_start(), int(model.joint("float").qposadr[0])
    data.qpos[place : place + 3] = q[first + 4 : first + 7]
    data.qpos[place + 3 : place + 7] = q[first : first + 4]
    mujoco.mj_forward(model, data)
    assert np.abs(data.efc_pos[:6]).max() < 1e-9


def test_parts_of_an_mjcf_that_are_not_read_are_named(tmp_path):
    path = tmp_path / "more.xml"
    more = '<sensor><jointpos joint="ref"/></sensor></mujoco>'
    text = UNLIKE.replace("</mujoco>", more)
    for begin, other in (
        ('<joint name="ref"', 'frictionloss="1"'),
        ('<motor name="drive"', 'damping="1"'),
    ):
        text = text.replace(begin, f"{begin} {other}")
    path.write_text(text)
    assert set(Mechanism.load(path).notes) == {
        "not read: 1 sensors",
        "not read: the dry friction of ref",
        "not read: the damping of the actuator drive",
    }


def test_joints_of_an_sdf_that_close_loops_are_cut_and_told():
    mechanism = Mechanism.load(MODELS / "four_bar.sdf")
    assert [joint.name() for joint in mechanism.joints] == ["shaft", "pin_1", "pin_2"]
    assert "the revolute joint bearing closes a loop, and is held by constraints" in (
        mechanism.notes
    )
    assert [joint.name() for joint in mechanism.motors] == ["shaft"]


def test_universal_joints_that_drake_cannot_turn_round_are_turned(tmp_path):
    # The table hangs on a universal joint whose parent it is.
    path = tmp_path / "table.sdf"
    path.write_text("""<sdf version="1.7"><model name="m">
      <link name="foot"><inertial><mass>1</mass></inertial></link>
      <link name="table"><pose>0 0 1 0 0 0</pose><inertial><mass>1</mass></inertial></link>
      <joint name="weld" type="fixed"><parent>world</parent><child>foot</child></joint>
      <joint name="cross" type="revolute2"><parent>table</parent><child>foot</child>
        <pose>0 0 0.4 0.3 0.2 0.1</pose>
        <axis><xyz>1 0 0</xyz></axis><axis2><xyz>0 1 0</xyz></axis2></joint>
    </model></sdf>""")
    mechanism = Mechanism.load(path)
    assert "1 joints revolute2 are read as universal" in mechanism.notes
    assert mechanism.mobility.freedoms == 2
    at_rest = mechanism.pose("table", mechanism.home)
    np.testing.assert_allclose(at_rest.translation(), (0.0, 0.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(at_rest.rotation().matrix(), np.eye(3), atol=1e-12)
    # The axes: x of the cross on the table, y of the cross on the foot, which stands.
    first = mechanism.joint("cross").position_start()
    for place, fixed_axis in ((first, (0.0, 1.0, 0.0)), (first + 1, (1.0, 0.0, 0.0))):
        q = mechanism.home.copy()
        q[place] += 0.3
        turn = mechanism.pose("table", q).rotation().matrix()
        cross = mechanism.pose("foot", q).rotation().matrix()
        from pydrake.math import RollPitchYaw

        axis = cross @ RollPitchYaw(0.3, 0.2, 0.1).ToRotationMatrix().matrix() @ fixed_axis
        np.testing.assert_allclose(turn @ axis, axis, atol=1e-12)


def test_elements_that_are_not_of_sdformat_are_left_out_and_named(tmp_path):
    text = (MODELS / "four_bar.sdf").read_text()
    path = tmp_path / "four_bar.sdf"
    path.write_text(text.replace('<link name="crank">', '<link name="crank"><static>0</static>'))
    mechanism = Mechanism.load(path)
    assert "not read: <static> of <link>, which is not of SDFormat" in mechanism.notes
    assert mechanism.mobility.freedoms == 1


def test_a_revolute2_with_one_axis_is_refused_by_name(tmp_path):
    path = tmp_path / "four_bar.sdf"
    text = (MODELS / "four_bar.sdf").read_text()
    path.write_text(text.replace('"pin_2" type="revolute"', '"pin_2" type="revolute2"'))
    with pytest.raises(ScenarioError, match="axis2 must be specified for joint 'pin_2'"):
        Mechanism.load(path)


def test_loops_that_rounding_lets_contradict_each_other_have_their_freedoms(tmp_path):
    # Hinges whose axes are parallel but for 1e-7 rad.
    text = (MODELS / "four_bar.sdf").read_text()
    path = tmp_path / "four_bar.sdf"
    head, tail = text.split('<joint name="pin_2"')
    path.write_text(head + '<joint name="pin_2"' + tail.replace("0 1 0", "2e-7 1 1e-7", 1))
    mechanism = Mechanism.load(path)
    assert mechanism.mobility.freedoms == 1
    assert mechanism.is_rounded
    assert not Mechanism.load(MODELS / "four_bar.sdf").is_rounded
    q = mechanism.forward([0.5], near=mechanism.home)
    assert np.abs(mechanism.residual(q)).max() < 1e-6
    rows, is_closed = mechanism.forward_rows([[0.5]])
    assert is_closed.all()
    np.testing.assert_allclose(rows[0], q, atol=1e-5)


def test_the_base_is_welded_unless_it_is_to_be_free(tmp_path):
    path = write(tmp_path, "closed_loop: [[end, goal]]\ntype: [3d]\nname_mot: [rail]\n")
    assert Mechanism.load(path).mobility.freedoms == 1
    assert Mechanism.load(path, is_free=True).mobility.freedoms == 7
