"""Tests of machines made of a model file: led, loaded, pushed, standing, refused."""

import io
import math
import re
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from parapod.diagrams.any_mechanism.controller import make_controls
from parapod.diagrams.any_mechanism.drivers import Epos2MotorAxes
from parapod.diagrams.any_mechanism.machine import MECHANISM
from parapod.diagrams.any_mechanism.scenario import MechanismScenario
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.drivers.driver import PartPorts
from parapod.sims.any_mechanism.load import MechanismLoad
from parapod.sims.any_mechanism.track import MechanismTrack, advice_on_loops, frame_error
from parapod.sims.any_mechanism.workspace import MechanismWorkspace
from parapod.sims.output.options import RunOptions
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.mechanism.equations import pose_vector

EXAMPLES = Path(__file__).parents[3] / "examples" / "mechanisms"
FILES = {
    "three_rps": "",
    "hexapod": f"{EXAMPLES}/hexapod/hexapod.urdf",
    "delta": f"{EXAMPLES}/delta/delta.xml",
}
# A way along the first coordinate, and back.
WAY = "track={waypoints: [{time: 0.8, z_mm: 12}, {time: 1.5}], begin: 0.2, end: 0.1}"
FEET = "machine.feet_mm=[[300, 0, -30], [-150, 260, -30], [-150, -260, -30]]"
TABLE = """
<robot name="table">
  <link name="base"/>
  <link name="beam"><inertial><mass value="2"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="along" type="prismatic"><parent link="base"/><child link="beam"/>
    <axis xyz="1 0 0"/><limit lower="-0.3" upper="0.3" effort="500" velocity="1"/></joint>
  <link name="plate"><inertial><mass value="1"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="across" type="prismatic"><parent link="beam"/><child link="plate"/>
    <axis xyz="0 1 0"/><limit lower="-0.1" upper="0.2" effort="500" velocity="1"/></joint>
</robot>
"""


def of(name):
    if name == "delta":
        pytest.importorskip("mujoco", reason="MJCF needs MuJoCo's compiler")
    return [f"machine.file={FILES[name]}"] if FILES[name] else []


def run(experiment, *overrides):
    scenario = load_scenario(experiment.schema, None, None, overrides)
    console = Console(file=io.StringIO(), quiet=True)
    return experiment.execute(scenario, RunOptions(console=console))


def track(*overrides):
    return run(MechanismTrack("mechanism-track"), *overrides)


def recorded(*overrides):
    scenario = load_scenario(MechanismScenario, None, None, overrides)
    loop = ClosedLoop(MECHANISM, scenario)
    simulator = loop.simulator()
    simulator.AdvanceTo(scenario.way.duration)
    return scenario, loop.recording(simulator.get_context())


def refused(*overrides):
    with pytest.raises(ParapodError) as error:
        track(*overrides)
    text = str(error.value)
    assert "\n" not in text
    return text


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("backend", ["kinematic", "multibody"])
def test_a_model_file_alone_makes_a_machine_that_holds_its_bounds(name, backend):
    result = track(*of(name), f"backend={backend}", WAY)
    assert result.broken == ()
    if backend == "kinematic":
        assert result["loop_error_um"] < 1e-3


@pytest.mark.parametrize("name", FILES)
def test_both_backends_go_the_same_way(name):
    """Bodies sag by their weight; without it they would be where the loops have them."""
    ways = []
    for backend in ("kinematic", "multibody"):
        scenario, now = recorded(*of(name), f"backend={backend}", WAY)
        ways.append(now["truth.pose"] - now["truth.pose"][20])
    size = scenario.machine.built.mechanism.size
    assert np.abs(ways[0][20:, :3] - ways[1][20:, :3]).max() < 1e-4 * size


def test_what_sags_does_so_with_the_square_of_the_time_of_a_swing():
    sag = {}
    for frequency in (40.0, 80.0):
        scenario, now = recorded(
            WAY, "machine.zero_error=0", f"machine.natural_frequency_Hz={frequency}"
        )
        sag[frequency] = abs(frame_error(scenario, now)[15, 0])
    assert sag[40.0] / sag[80.0] == pytest.approx(4.0, rel=1e-3)


def test_errors_of_the_encoders_zeros_are_those_of_the_pose_by_the_jacobian():
    scenario, now = recorded("backend=kinematic", WAY, "machine.zero_error=0.001", "seed=4")
    built = scenario.machine.built
    errors = scenario.zero_errors
    assert np.abs(errors).max() > 1e-4
    first = now["truth.pose"][0] - pose_vector(built.mechanism.pose(built.frame, built.q))
    moved = built.mechanism.frame_jacobian(built.frame, built.q) @ errors
    assert first[:3] == pytest.approx(moved[3:], abs=1e-5)
    estimated = now["pose_estimated"][0][list(built.parts)]
    assert estimated == pytest.approx(built.home, abs=1e-5)


@pytest.mark.parametrize("backend", ["kinematic", "multibody"])
def test_actuators_with_pi_controllers_hold_the_same_bounds(backend):
    result = track("machine.drives=!PiActuators {}", f"backend={backend}", WAY)
    assert result.broken == ()


def test_with_error_control_the_frame_is_where_steps_have_it():
    _, steps = recorded(WAY)
    _, smooth = recorded(WAY, "plant.accuracy=1e-4")
    assert steps["truth.pose"] == pytest.approx(smooth["truth.pose"], abs=2e-5)


def test_a_base_on_the_ground_stands_until_it_is_pushed_over():
    standing = ("machine.base=ground", FEET, WAY)
    _, still = recorded(*standing)
    assert np.abs(still["truth.base"][-1, :3]).max() < 1e-3
    push = "disturbances=[!Push {at: 0.5, duration: 0.6, force_N: [0, FORCE, 0]}]"
    for force, is_over in ((100, False), (1500, True)):
        _, pushed = recorded(*standing, push.replace("FORCE", str(force)))
        tilt = np.abs(pushed["truth.base"][:, 3:5]).max()
        assert (tilt > math.radians(5.0)) == is_over


def test_a_push_on_the_frame_is_borne_by_the_motors():
    """Their power is the push's: the forces are those of virtual work."""
    push = "disturbances=[!Weight {at: 0.3, duration: 0.3, mass_kg: 8}]"
    stay = "track={waypoints: [{time: 0.5}], begin: 0.1, end: 0.7}"
    scenario, now = recorded(push, stay, "machine.zero_error=0")
    built = scenario.machine.built
    rise = now["truth.motor_force"][-1] - now["truth.motor_force"][25]
    moves = built.mechanism.frame_jacobian(built.frame, built.q)
    assert rise == pytest.approx(moves[5] * 9.80665 * 8.0, rel=2e-3)


@pytest.mark.parametrize("name", FILES)
def test_bodies_and_statics_have_the_same_forces(name):
    result = run(MechanismLoad("mechanism-load"), *of(name))
    assert result.broken == ()
    assert result["force_error_percent"] < 0.5


def test_a_mass_that_is_carried_is_the_largest_one():
    mass = run(MechanismLoad("mechanism-load"))["home_payload_kg"]
    share = run(MechanismLoad("mechanism-load"), f"mass_kg={mass:.6g}")["force_share"]
    assert share == pytest.approx(1.0, rel=1e-2)


def table_in(folder):
    (folder / "table.urdf").write_text(TABLE)
    (folder / "table.yaml").write_text("name_mot: [along, across]\n")
    return folder / "table.urdf"


def test_the_workspace_of_a_table_is_the_product_of_its_ways(tmp_path):
    file = f"machine.file={table_in(tmp_path)}"
    result = run(MechanismWorkspace("mechanism-workspace"), file, "cells=41")
    assert result["workspace"] == pytest.approx(0.6 * 0.3, rel=0.15)
    error = result["workspace_error_percent"] / 100.0
    assert abs(result["workspace"] / (0.6 * 0.3) - 1.0) < 2.0 * error
    assert result["x_extent_mm"] == pytest.approx(600.0, rel=0.08)


def test_a_finer_grid_has_a_smaller_error():
    errors = [
        run(MechanismWorkspace("mechanism-workspace"), f"cells={n}", "coordinates=[z, roll]")[
            "workspace_error_percent"
        ]
        for n in (16, 32)
    ]
    assert errors[1] == pytest.approx(0.5 * errors[0], rel=0.25)


def test_a_machine_file_names_the_model_beside_it(tmp_path):
    table_in(tmp_path)
    mine = tmp_path / "mine.yaml"
    mine.write_text("file: table.urdf\nframe: plate\n")
    scenario = load_scenario(MechanismScenario, None, None, (), mine)
    built = scenario.machine.built
    assert built.motors.names == ("along", "across")
    assert built.parts == (0, 1)
    assert built.motors.forces == (500.0, 500.0)
    assert built.motors.velocities == (1.0, 1.0)


def test_a_machine_file_names_an_mjcf_beside_it(tmp_path, monkeypatch):
    pytest.importorskip("mujoco", reason="MJCF needs MuJoCo's compiler")
    (tmp_path / "robot.xml").write_text(Path(FILES["delta"]).read_text())
    (tmp_path / "mine.yaml").write_text("file: robot.xml\n")
    monkeypatch.chdir(tmp_path.parent)
    machine = load_scenario(MechanismScenario, None, None, (), tmp_path / "mine.yaml").machine
    assert machine.path == tmp_path / "robot.xml"
    assert len(machine.built.motors.names) == 3


def test_a_home_at_an_end_of_a_joint_is_told_of(tmp_path):
    file = f"machine.file={table_in(tmp_path)}"
    settings = (file, "machine.frame=beam", "machine.coordinates=[x]", "machine.home=[0.3, 0]")
    blocked = TABLE.replace('lower="-0.3" upper="0.3"', 'lower="0.3" upper="0.3000001"')
    assert MechanismScenario(machine=machine_of(*settings)).machine.built.stopped == ("along",)
    (tmp_path / "table.urdf").write_text(blocked)
    assert "cannot leave its home; at an end there: along" in refused(*settings)
    with pytest.raises(ParapodError, match="reaches no pose around its home; at an end there: al"):
        run(MechanismWorkspace("mechanism-workspace"), *settings)
    with pytest.raises(ParapodError, match="at an end would bear a part of the mass: along"):
        run(MechanismLoad("mechanism-load"), *settings)
    assert "along is 0.3 beyond its limits there" in refused(file, "machine.home=[0, 0]")


def machine_of(*overrides):
    return load_scenario(MechanismScenario, None, None, overrides).machine


STANDING = """
<mujoco>
  <worldbody>
    <body name="trunk" pos="0 0 0.5">{joint}
      <inertial pos="0 0 0" mass="20" diaginertia="1 1 1"/>
      <body name="mast" pos="0 0 0.2">
        <joint name="lift" type="slide" axis="0 0 1" limited="true" range="-0.1 0.1"/>
        <inertial pos="0 0 0" mass="5" diaginertia="0.1 0.1 0.1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="lift" joint="lift"/></actuator>
</mujoco>
"""


@pytest.mark.parametrize("joint", ["", "<freejoint/>"])
def test_the_base_stands_as_the_machine_says_whatever_the_file_does(tmp_path, joint):
    pytest.importorskip("mujoco", reason="MJCF needs MuJoCo's compiler")
    path = tmp_path / "mast.xml"
    path.write_text(STANDING.replace("{joint}", joint))
    settings = (f"machine.file={path}", "machine.frame=mast", WAY)
    feet = "machine.feet_mm=[[300, 0, -30], [-150, 260, -30], [-150, -260, -30]]"
    forces = []
    for base in (("machine.base=welded",), ("machine.base=ground", feet)):
        scenario, now = recorded(*settings, *base)
        assert np.abs(frame_error(scenario, now)).max() < 1e-3
        forces.append(now["truth.motor_force"][-1])
        assert np.ptp(now["truth.pose"][:, 2]) == pytest.approx(0.012, abs=5e-4)
    # Of both the motor bears the mast's weight.
    np.testing.assert_allclose(forces, 5.0 * 9.81, rtol=5e-3)


def test_a_pose_out_of_reach_is_refused_with_its_time():
    words = "does not get to its pose at .* s: a motor would have to jump"
    assert re.search(words, refused(*of("delta"), "track.waypoints=[{time: 60, z_mm: 900}]"))


def test_links_may_be_made_heavier_than_in_their_file(tmp_path):
    file = f"machine.file={table_in(tmp_path)}"
    masses = []
    for least in (0.0, 1.5):
        plant = machine_of(file, f"machine.least_mass_kg={least}").built.mechanism.plant
        masses.append(plant.CalcTotalMass(plant.CreateDefaultContext()))
    # Beam and plate weigh 2 and 1 kg.
    np.testing.assert_allclose(masses, (3.0, 3.5))


def test_advice_is_given_where_loops_are_soft():
    scenario = load_scenario(MechanismScenario, None, None, ())
    soft, stiff = ({"truth.loop_error": np.array([[gap, 0.0]])} for gap in (1e-3, 1e-6))
    (advice,) = advice_on_loops(scenario, soft)
    assert "plant.time_step below 0.001 s" in advice
    assert not list(advice_on_loops(scenario, stiff))


def test_motors_that_turn_measure_their_currents():
    device = Epos2MotorAxes(node_ids=[1, 2]).make(PartPorts({}, {}))
    assert device.measures["current"] == 2


class Sliders:
    """Controls whose sliders a test moves."""

    def __init__(self):
        self.values = {}

    def GetSliderNames(self):
        return list(self.values)

    def GetSliderValue(self, name):
        return self.values[name]


def test_ways_are_told_from_another_home():
    scenario, now = recorded("backend=kinematic", "machine.home=[0.02, 0.02, 0.02]", WAY)
    built = scenario.machine.built
    assert built.motors.home == pytest.approx([0.02] * 3)
    assert built.home[0] > 0.51
    assert np.abs(frame_error(scenario, now)).max() < 1e-3


def test_links_without_inertia_are_simulated_by_kinematics_alone(tmp_path):
    file = table_in(tmp_path)
    light = re.sub(r'(<link name="plate">).*?(</link>)', r"\1\2", TABLE, flags=re.DOTALL)
    file.write_text(light)
    way = "track={waypoints: [{time: 1, x_mm: 50, y_mm: 20}], begin: 0.1, end: 0}"
    settings = (f"machine.file={file}", way)
    assert track(*settings, "backend=kinematic").broken == ()
    assert "plate have no inertia" in refused(*settings, "backend=multibody")


def test_sliders_move_the_frame_no_faster_than_its_motors_may():
    scenario = MechanismScenario(backend="kinematic")
    built, sliders = scenario.machine.built, Sliders()
    source = make_controls(scenario, sliders)
    loop = ClosedLoop(MECHANISM, scenario, sources=(source,))
    simulator = loop.simulator()
    simulator.AdvanceTo(0.1)
    sliders.values["z [mm]"] = 1e3 * built.home[0] + 60.0
    simulator.AdvanceTo(3.0)
    now = loop.recording(simulator.get_context())
    assert now["truth.pose"][-1, 2] - built.home[0] == pytest.approx(0.06, abs=5e-4)
    assert np.abs(now["motors.velocity"]).max() < max(built.motors.velocities)


def test_what_makes_no_machine_is_refused_in_a_line(tmp_path):
    file = f"machine.file={table_in(tmp_path)}"
    assert "no such file" in refused("machine.file=nothing.urdf")
    assert "has no joint 'lenght_1'" in refused("machine.motors=[lenght_1]")
    assert "4 motors are too many for 3" in refused("machine.motors=['length_?', hinge_1]")
    assert "has no frame 'plat'" in refused("machine.frame=plat")
    assert "'up' is not one of x, y, z" in refused("machine.coordinates=[up]")
    assert "cannot set x, y, z of platform" in refused("machine.coordinates=[x, y, z]")
    assert "3 points or more" in refused("machine.base=ground")
    assert "must be three numbers" in refused(
        "machine.base=ground", "machine.feet_mm=[[0, 0], [1, 0, 0], [0, 1, 0]]"
    )
    assert "x_mm must be 0" in refused("track.waypoints=[{time: 2, x_mm: 5}]")
    assert "must be above 2 s" in refused("track.waypoints=[{time: 2}, {time: 2}]")
    assert "beyond its limits" in refused("track.waypoints=[{time: 2, z_mm: 150}]")
    assert "times as fast as it is" in refused("track.waypoints=[{time: 0.6, z_mm: 50}]")
    assert "times as quick as it is" in refused(
        WAY, "machine.drives=!PositionServos {max_acceleration: 0.01}"
    )
    assert "times as strong as it is, at" in refused(WAY, "machine.max_force=30")
    assert "must be 3 numbers" in refused("machine.home=[0.01]")
    assert "beyond its limits at" in refused(file, "track.waypoints=[{time: 99, x_mm: 400}]")
    assert "no body 'sail'" in refused(WAY, "disturbances=[!Push {body: sail}]")
