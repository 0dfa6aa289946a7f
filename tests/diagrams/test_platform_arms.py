"""Arms of the levelling platform: kinds, drives, ports, from none to seven joints."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.designs import check_design
from parapod.diagrams.levelling_platform.arm_admission import check_swing
from parapod.diagrams.levelling_platform.arms import FlexibleRod, NoArm, Rod, Urdf
from parapod.diagrams.levelling_platform.controller import make_supervised_controller
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.station import Station
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import dump_scenario, load_scenario
from parapod.systems.core.units import units_of
from parapod.systems.levelling_platform.scripts import OperatorScript

INERTIA = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
LINK = '<link name="{}"><inertial><origin xyz="0 0 0.1"/><mass value="0.5"/>{}</inertial></link>'
JOINT = """<joint name="{}" type="{}"><origin xyz="0 0 0.2"/><parent link="{}"/><child link="{}"/>
<axis xyz="{}"/>{}</joint>"""
ACTUATOR = '<transmission type="SimpleTransmission"><joint name="{0}"/><actuator name="{0}"/>{1}'
# Name, kind, axis and limits, from the mount to the tip.
CHAIN = (
    ("a", "continuous", "0 0 1", ""),
    ("b", "revolute", "0 1 0", '<limit lower="-1.2" upper="1.4" effort="50" velocity="2"/>'),
    ("c", "prismatic", "0 0 1", '<limit lower="-0.1" upper="0.3" effort="500" velocity="1"/>'),
    ("d", "revolute", "1 0 0", '<limit lower="-2" upper="2" effort="50" velocity="2"/>'),
)


@pytest.fixture
def chain(tmp_path):
    """chain(*settings): scenario of a platform with an arm of four joints."""
    links = ["foot", *(f"link_{name}" for name, *_ in CHAIN)]
    parts = [LINK.format(link, INERTIA) for link in links]
    parts += [
        JOINT.format(name, kind, links[i], links[i + 1], axis, limit)
        for i, (name, kind, axis, limit) in enumerate(CHAIN)
    ]
    # Two are driven already, in another order than that of the chain.
    parts += [ACTUATOR.format(name, "</transmission>") for name in ("d", "b")]
    parts.append('<frame name="tool" link="link_d" xyz="0 0 0.25" rpy="0 0 0"/>')
    file = tmp_path / "chain.urdf"
    file.write_text(f'<robot name="chain">{"".join(parts)}</robot>')

    def make(*settings, tip="tool", backend="multibody"):
        arm = f"machine.arm=!Urdf {{file: {file}, mount: foot, tip: {tip}}}"
        base = "plant={leg_model: reduced, time_step: 0.005}"
        overrides = (f"backend={backend}", arm, base, *settings)
        return load_scenario(LevellingScenario, overrides=overrides)

    return make


def of(*settings, backend="kinematic"):
    return load_scenario(LevellingScenario, overrides=(f"backend={backend}", *settings))


@pytest.mark.parametrize(
    ("setting", "arm"),
    [
        ("machine.arm.length_mm=1500", Rod(length_mm=1500.0)),
        ("machine.arm={length_mm: 1500}", Rod(length_mm=1500.0)),
        ("machine.arm=!None", NoArm()),
        ("machine.arm=!None {base_mm: [0, 0, 100]}", NoArm(base_mm=[0.0, 0.0, 100.0])),
        ("machine.arm=!FlexibleRod {modes: 3}", FlexibleRod(modes=3)),
        ("machine.arm=!Urdf {file: a.urdf, tip: b}", Urdf(file="a.urdf", tip="b")),
    ],
)
def test_a_tag_chooses_the_arm_and_without_one_it_is_the_rod(setting, arm, tmp_path):
    scenario = of(setting)
    assert scenario.machine.arm == arm
    file = tmp_path / "mine.yaml"
    file.write_text(dump_scenario(scenario))
    assert load_scenario(LevellingScenario, None, file) == scenario


def test_other_tags_are_refused_with_those_that_there_are():
    with pytest.raises(ScenarioError, match="!Rod, !FlexibleRod, !Urdf, !None, not !Robot"):
        of("machine.arm=!Robot {}")


def test_the_former_key_of_the_stiffness_is_read():
    with pytest.warns(DeprecationWarning, match=r"is now drives\.stiffness_Nm_rad"):
        scenario = of("machine.arm.stiffness_Nm_rad=1e5")
    assert scenario.machine.arm.drives.stiffness_Nm_rad == 1e5


def test_rod_and_camera_are_the_drawn_arm():
    rod, flexible = (
        of(s).machine.masses for s in ("machine.arm={}", "machine.arm=!FlexibleRod {}")
    )
    assert flexible.mass == pytest.approx(rod.mass, abs=1e-12)
    for drawn, own in zip(rod.arm.links, flexible.arm.links, strict=True):
        assert own.mass == pytest.approx(drawn.mass, abs=1e-12)
        np.testing.assert_allclose(own.centre, drawn.centre, rtol=0.0, atol=1e-4)
        np.testing.assert_allclose(own.inertia, drawn.inertia, rtol=0.0, atol=1e-4)


def test_joints_of_ones_own_are_those_between_mount_and_tip(chain):
    arm = chain().machine.masses.arm
    assert [joint.name for joint in arm.joints] == ["a", "b", "c", "d"]
    assert [joint.kind for joint in arm.joints] == ["revolute"] * 2 + ["prismatic", "revolute"]
    limits = [(joint.lower, joint.upper) for joint in arm.joints]
    turn = 2.0 * math.pi
    np.testing.assert_allclose(limits, [(-turn, turn), (-1.2, 1.4), (-0.1, 0.3), (-2.0, 2.0)])
    x, y, z = (1e-3 * c for c in (0.0, 20.0, 145.0))
    np.testing.assert_allclose(arm.tip_pose([0.0] * 4).place, (x, y, z + 1.05), atol=1e-12)


def test_drives_limit_what_their_joints_leave_free(chain):
    drives = (
        "{}, {lower_deg: -30, upper_deg: 300, max_speed_deg_s: 50}, {max_speed_deg_s: 200}, {}"
    )
    machine = chain(f"machine.arm.each_drive=[{drives}]").machine
    second = machine.arm_drives[1]
    assert (second.lower, second.upper) == pytest.approx((math.radians(-30.0), 1.4))
    assert second.max_velocity == pytest.approx(math.radians(50.0))
    assert machine.arm_drives[2].max_velocity == pytest.approx(0.2)
    monitor = machine.stability_monitor
    assert monitor.rate[1] == pytest.approx(0.5 * math.radians(50.0))
    assert monitor.reach[1] == pytest.approx((math.radians(-30.0), 1.4))


@pytest.mark.parametrize("backend", ["multibody", "kinematic", "mock"])
def test_every_joint_goes_where_it_is_commanded_and_shows_it(chain, backend):
    scenario = chain("machine.arm.drives.max_effort_Nm=80", backend=backend)
    station = Station(PLATFORM, scenario)
    assert station.machine.element_name("arm.position_command", 2) == "c"
    port = station.machine.table["arm.position"]
    assert [str(unit) for unit in units_of(port.unit, 4)] == ["rad", "rad", "m", "rad"]
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    goal = [0.2, 0.3, 0.05, -0.4]
    for name, value in {"arm.position_command": goal}.items():
        station.GetInputPort(name).FixValue(context, value)
    for i in range(station.num_input_ports()):
        sink = station.get_input_port(i)
        if sink.get_name() != "arm.position_command":
            value = 1.0 if sink.get_name() == "wheels.brake" else 0.0
            sink.FixValue(context, np.full(sink.size(), value))
    station.reset(context, scenario)
    simulator.AdvanceTo(1.0)
    np.testing.assert_allclose(station.GetOutputPort("arm.position").Eval(context), goal)
    np.testing.assert_allclose(
        station.GetOutputPort("arm.velocity").Eval(context), 0.0, atol=1e-12
    )
    if backend == "multibody":
        model = station.behind.handle.plant.model
        plant = model.plant
        of_plant = plant.GetMyContextFromRoot(context)
        found = [joint.GetOnePosition(of_plant) for joint in model.arm_joints]
        np.testing.assert_allclose(found, goal, rtol=0.0, atol=2e-3)
        assert [joint.name() for joint in model.arm_joints] == ["a", "b", "c", "d"]
        actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices(model.arm))
        assert [actuator.effort_limit() for actuator in actuators] == [80.0] * 4


@pytest.mark.parametrize(
    ("settings", "tip", "words"),
    [
        ((), "nose", "machine.arm.tip = 'nose' is not a link"),
        ((), "''", "machine.arm.tip = '' is not a link"),
        ((), "link_c", "'d' moves, so it must be among them"),
        (("machine.arm.joints=[b, a, c, d]",), "tool", "the joints that move are: a, b, c, d"),
        (("machine.arm.mount=link_d",), "foot", "does not hang on"),
        (("machine.arm.drives.max_effort_Nm=5",), "tool", "to hold the arm takes"),
    ],
)
def test_an_arm_of_ones_own_that_does_not_do_is_refused(chain, settings, tip, words):
    with pytest.raises(ScenarioError) as refused:
        check_design(chain(*settings, tip=tip).machine)
    assert words in str(refused.value)


def test_a_swing_is_refused_that_its_drives_or_the_ground_do_not_admit():
    machine = of("machine.arm.drives.max_effort_Nm=40").machine
    keys = ("job.arm.angle_deg", "job.arm.duration")
    goal = (0.0, math.radians(45.0))
    check_swing(machine, goal, 1.0, keys)
    with pytest.raises(ScenarioError, match=r"the swing takes 73\.9 N m, and it has 40 N m"):
        check_swing(machine, goal, 0.5, keys)
    low = of("machine.arm={base_mm: [900, 0, -300], drives: {upper_deg: 120}}").machine
    with pytest.raises(ScenarioError, match=r"the arm's tip would be \d+ mm below level ground"):
        check_swing(low, (0.0, math.radians(120.0)), 2.0, keys)


@pytest.mark.parametrize("backend", ["kinematic", "multibody", "mock"])
def test_without_an_arm_there_are_no_ports_for_it_and_the_platform_works(backend):
    scenario = of(
        "machine.arm=!None", "plant={leg_model: reduced, time_step: 0.005}", backend=backend
    )
    check_design(scenario.machine)
    loop = ClosedLoop(PLATFORM, scenario, log=("attitude_estimated",))
    assert not [name for name in loop.station.machine.table if name.startswith("arm")]
    simulator = Simulator(loop)
    simulator.AdvanceTo(0.3)
    assert np.isfinite(loop.recording(simulator.get_context())["attitude_estimated"]).all()


def test_a_supervised_platform_without_an_arm_has_a_margin():
    scenario = of("machine.arm=!None")
    operator = OperatorScript((), (0.0, 0.0, 0.477), joints=0)
    controller = make_supervised_controller(scenario)
    loop = ClosedLoop(
        PLATFORM, scenario, controller=controller, sources=[operator], log=("stability_margin",)
    )
    simulator = Simulator(loop)
    simulator.AdvanceTo(0.1)
    assert loop.recording(simulator.get_context())["stability_margin"][-1, 0] > 0.1


def test_devices_of_a_platform_without_an_arm_need_none_for_it():
    drivers = "[!NiDaqLegs {}, !Adis16448SpiImu {}, !NotFittedPart {part: wheels}]"
    scenario = of("machine.arm=!None", f"hardware.drivers={drivers}", backend="hardware")
    station = Station(PLATFORM, scenario)
    assert station.GetOutputPort("status.age").size() == 4


def test_a_public_robots_file_is_a_part(tmp_path):
    """It stands in a world of its own, and its shapes are meshes that Drake does not read."""
    shape = '<{0}><geometry><mesh filename="meshes/{1}"/></geometry></{0}>'
    body = f'<inertial><mass value="1"/>{INERTIA}</inertial>'
    shapes = shape.format("collision", "base.stl") + shape.format("visual", "base.obj")
    limit = '<limit lower="-2" upper="2" effort="50" velocity="2"/>'
    file = tmp_path / "robot.urdf"
    file.write_text(
        '<robot name="robot"><link name="world"/>'
        f'<link name="base_link">{body}{shapes}</link><link name="tool0">{body}</link>'
        '<joint name="world_joint" type="fixed"><parent link="world"/><child link="base_link"/>'
        f"</joint>{JOINT.format('turn', 'revolute', 'base_link', 'tool0', '0 1 0', limit)}</robot>"
    )
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "base.stl").write_text("solid base\nendsolid base\n")
    (tmp_path / "meshes" / "base.obj").write_text(
        "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
    )
    machine = of(f"machine.arm=!Urdf {{file: {file}, tip: tool0}}").machine
    check_design(machine)
    assert [joint.name for joint in machine.masses.arm.joints] == ["turn"]
    assert machine.masses.arm.mass == pytest.approx(1.0)
