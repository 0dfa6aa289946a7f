"""Legs under test: what a URDF must have, what is told of it, and its impedance."""

import re
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.terrain_simulator.design import SliderScenario
from parapod.diagrams.terrain_simulator.leg import LegDescription, UrdfLeg, add_leg, make_leg_model
from parapod.diagrams.terrain_simulator.scenario import (
    HipScenario,
    TerrainBenchScenario,
)
from parapod.systems.core.errors import ScenarioError
from parapod.systems.terrain_simulator.impedance import FootImpedance, ImpedanceParams
from parapod.systems.terrain_simulator.leg import UnreachableFoot

OWN = LegDescription()
FOREIGN = LegDescription(
    "package://parapod/terrain_simulator/digitigrade.urdf",
    "mount",
    "toe",
    ("HFE", "KFE", "AFE"),
    (0.75, -1.35, 0.9),
    0.022,
    (220.0, 220.0, 160.0),
)
legs = pytest.mark.parametrize("leg", [OWN, FOREIGN], ids=["own", "foreign"])


@legs
def test_the_foot_is_where_its_joints_were_sought_for(leg):
    model = make_leg_model(leg)
    context = model.make_context()
    for place in ((0.0, -0.58), (0.15, -0.6), (-0.12, -0.5)):
        q = model.reach(place)
        np.testing.assert_allclose(model.place(context, q), place, atol=1e-9)
        low, high = model.limits
        assert (q >= low).all()
        assert (q <= high).all()


def test_the_two_links_reach_as_trigonometry_has_it():
    model, length = make_leg_model(OWN), 0.6
    hip, knee = model.reach((0.0, -length))
    bend = np.arccos(0.5 * length / 0.35)
    assert (hip, knee) == pytest.approx((bend, -2.0 * bend), abs=1e-9)
    # A force along the leg loads the knee with its lever.
    state = model.foot_state(model.make_context(), (hip, knee), (0.0, 0.0))
    torque = np.array((0.0, -500.0)) @ np.array(state.jacobian)
    assert torque[0] == pytest.approx(0.0, abs=1e-6)
    assert abs(torque[1]) == pytest.approx(500.0 * 0.35 * np.sin(bend))


@legs
def test_the_order_of_the_joints_is_the_users(leg):
    back = replace(
        leg,
        joints=leg.joints[::-1],
        posture=leg.posture[::-1],
        max_torque=None if leg.max_torque is None else leg.max_torque[::-1],
    )
    one, other = make_leg_model(leg), make_leg_model(back)
    q = one.reach((0.05, -0.58))
    v = np.linspace(0.4, -0.3, one.joints)
    there = one.foot_state(one.make_context(), q, v)
    here = other.foot_state(other.make_context(), q[::-1], v[::-1])
    np.testing.assert_allclose(here.place, there.place, atol=1e-12)
    np.testing.assert_allclose(here.jacobian, np.array(there.jacobian)[:, ::-1], atol=1e-12)
    np.testing.assert_allclose(here.inertia, there.inertia, rtol=1e-9)
    np.testing.assert_allclose(here.holding, there.holding[::-1], atol=1e-12)


def test_places_out_of_reach_are_refused_with_what_is_missing():
    with pytest.raises(UnreachableFoot, match=r"x, z = 500, -800 mm from the hip: 2\d\d|\d+") as e:
        make_leg_model(OWN).reach((0.5, -0.8))
    # Links of 350 mm each, and a knee that is never quite straight.
    assert e.value.missing == pytest.approx(np.hypot(0.5, 0.8) - 0.7, rel=0.03)
    with pytest.raises(UnreachableFoot):
        make_leg_model(OWN).follow([(0.0, -0.6), (0.0, -0.9)])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"urdf": "nowhere.urdf"}, r"leg.urdf = 'nowhere.urdf': there is no such file"),
        ({"hip_frame": "pelvis"}, r"leg.hip_frame = 'pelvis' is not a link of .*: .*thigh"),
        ({"foot_frame": "toe"}, r"leg.foot_frame = 'toe' is not a link of"),
        ({"joints": ("hip",)}, r"leg.joints: 'knee' moves, so it must be among them"),
        (
            {"joints": ("hip", "kneee")},
            r"'kneee' is not a moving joint of .*; there are: hip, knee",
        ),
        ({"joints": ("hip", "knee", "hip")}, r"names a joint twice"),
        ({"posture": (0.1,)}, r"leg.posture must have 2 numbers, as leg.joints, not 1"),
        ({"max_torque": (1.0,)}, r"leg.max_torque must have 2 numbers"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_a_leg_that_is_none_is_refused_in_one_line(given, words):
    with pytest.raises(ScenarioError, match=words) as caught:
        make_leg_model(replace(OWN, **given))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_robot_is_refused(tmp_path):
    path = tmp_path / "leg.urdf"
    path.write_text("<robot name='x'><link/></robot>")
    with pytest.raises(ScenarioError, match=r"cannot be read: |must have one model"):
        make_leg_model(replace(OWN, urdf=str(path)))


def torque(leg, q, v, foot, push=0.0, stance=1.0, params=ImpedanceParams()):
    system = FootImpedance(make_leg_model(leg), params)
    context = system.CreateDefaultContext()
    for name, value in (
        ("position", q),
        ("velocity", v),
        ("foot_desired", foot),
        ("foot_force_desired", [push]),
        ("stance", [stance]),
    ):
        system.GetInputPort(name).FixValue(context, value)
    return system.get_output_port().Eval(context)


@legs
def test_torques_in_stance_press_as_much_as_is_asked(leg):
    """Torques of a foot in its place, by virtual work; the leg's weight is taken off."""
    model = make_leg_model(leg)
    place = np.array((0.03, -0.57))
    q, rest = model.reach(place), np.zeros(model.joints)
    state = model.foot_state(model.make_context(), q, rest)
    given = torque(leg, q, rest, np.concatenate((place, np.zeros(4))), push=300.0)
    given -= torque(leg, q, rest, np.concatenate((place, np.zeros(4))))
    np.testing.assert_allclose(given, -300.0 * np.array(state.jacobian[1]), atol=1e-9)


@legs
@pytest.mark.parametrize(("stance", "stiffness"), [(1.0, (4e3, 8e3)), (0.0, (1.5e4, 1.5e4))])
def test_a_foot_off_its_place_is_pulled_there_by_its_springs(leg, stance, stiffness):
    model = make_leg_model(leg)
    place = np.array((0.03, -0.57))
    q, rest = model.reach(place), np.zeros(model.joints)
    state = model.foot_state(model.make_context(), q, rest)
    off = np.array((0.004, -0.003))
    there = np.concatenate((place + off, np.zeros(4)))
    at_rest = torque(leg, q, rest, np.concatenate((place, np.zeros(4))), stance=stance)
    pulled = torque(leg, q, rest, there, stance=stance) - at_rest
    force = np.transpose(state.inverse) @ pulled  # the spring acts against nothing but the foot
    np.testing.assert_allclose(force, np.array(stiffness) * off, rtol=1e-3)


def test_joints_beyond_two_are_led_to_their_posture_without_moving_the_foot():
    model = make_leg_model(FOREIGN)
    place = np.array((0.03, -0.57))
    q, rest = model.reach(place), np.zeros(3)
    state = model.foot_state(model.make_context(), q, rest)
    foot = np.concatenate((place, np.zeros(4)))
    led = torque(FOREIGN, q, rest, foot)
    free = torque(FOREIGN, q, rest, foot, params=ImpedanceParams(posture=(0.0, 0.0)))
    more = led - free
    assert np.abs(more).max() > 1.0
    np.testing.assert_allclose(np.transpose(state.inverse) @ more, 0.0, atol=1e-3)
    mirrored = replace(FOREIGN, posture=tuple(2.0 * q - np.array(FOREIGN.posture)))
    np.testing.assert_allclose(torque(mirrored, q, rest, foot) - free, -more, atol=1e-9)


# --- legs that somebody else has built


def written(path, share=1.0, more=""):
    """Description of the default leg in a file, its masses and inertias times a share."""

    def scaled(match):
        return f'{match[1]}="{share * float(match[2])!r}"'

    text = files("parapod.urdf.terrain_simulator").joinpath("leg.urdf").read_text()
    text = re.sub(r'(?<=<mass )(value)="([^"]+)"', scaled, text)
    text = re.sub(r'\b(i[xyz]{2})="([^"]+)"', scaled, text)
    path.write_text(text.replace("</robot>", f"{more}</robot>"))
    return replace(OWN, urdf=str(path))


def test_springs_and_dampers_follow_the_mass_that_the_foot_shows(tmp_path):
    usual = ImpedanceParams()
    assert UrdfLeg(OWN).impedance == usual
    light = UrdfLeg(written(tmp_path / "leg.urdf", 0.3))
    for name in ("stance_stiffness", "stance_damping", "swing_damping", "posture"):
        assert getattr(light.impedance, name) == pytest.approx(
            0.3 * np.array(getattr(usual, name))
        )
    given = replace(light, gains=(("swing_damping", (7.0, 9.0)),)).impedance
    assert given.swing_damping == (7.0, 9.0)
    assert given.stance_damping == light.impedance.stance_damping
    # A file that has been changed is read again.
    heavier = UrdfLeg(written(tmp_path / "leg.urdf", 0.6))
    assert heavier.mass == pytest.approx(2.0 * 0.3 * UrdfLeg(OWN).mass)
    assert heavier.impedance.stance_stiffness[0] == pytest.approx(0.6 * 4e3)


def test_the_guard_cannot_be_switched_off():
    with pytest.raises(ScenarioError, match=r"least_sin_mu = 0(\.0)? is outside 0\.05\.\."):
        SliderScenario(least_sin_mu=0.0)


def test_damping_with_which_a_sampled_foot_would_rattle_is_refused():
    leg = UrdfLeg(OWN, (("stance_damping", (150.0, 400.0)),))
    words = r"leg.stance_damping_Ns_m = 400 N s/m is too much for a foot of 0\.\d+ kg; with "
    with pytest.raises(ScenarioError, match=words + r"control.period = 0.001 s it is at most \d+"):
        leg.check(WALK, 1e-3)
    leg.check(WALK, 5e-4)
    leg.check(WALK, 0.0)


def test_the_other_legs_are_as_stiff_as_their_load_is_heavy():
    usual, light = HipScenario().support, HipScenario(mass_kg=3.0).support
    assert (usual.stiffness, usual.damping) == (2e4, 1100.0)
    assert (light.stiffness, light.damping) == pytest.approx((2e3, 110.0))
    assert HipScenario(mass_kg=3.0, stiffness_N_m=50.0, damping_Ns_m=0.0).support.stiffness == 50.0


WALK = TerrainBenchScenario().walk
MESH = """
<link name="shell"><visual><geometry><mesh filename="package://{}/shell.obj"/></geometry></visual>
</link>
<joint name="screws" type="fixed"><parent link="hip"/><child link="shell"/></joint>
"""


def drawn(leg):
    """Parses a leg with its shapes, as for a scene."""
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    add_leg(plant, leg, plant.world_frame(), scene_graph)


def test_meshes_are_found_in_the_package_that_a_leg_is_in(tmp_path):
    package = tmp_path / "some_robot"
    (package / "urdf").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>their_robot</name></package>")
    (package / "shell.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    drawn(written(package / "urdf" / "leg.urdf", more=MESH.format("their_robot")))
    lost = written(package / "urdf" / "leg.urdf", more=MESH.format("another_robot"))
    with pytest.raises(ScenarioError, match="refers to unknown package 'another_robot'") as caught:
        drawn(lost)
    assert "\n" not in str(caught.value)


def test_what_drake_does_not_like_in_a_file_is_told_once(tmp_path, caplog):
    path = tmp_path / "leg.urdf"
    leg = written(path)
    text = path.read_text()
    at = text.index("<axis")
    path.write_text(f'{text[:at]}<dynamics damping="0" friction="0.2"/>{text[at:]}')
    for _ in range(3):
        make_leg_model(leg)
    told = [record for record in caplog.records if "friction" in record.getMessage()]
    assert len(told) == 1


def test_a_model_directive_describes_a_leg_too(tmp_path):
    path = tmp_path / "leg.dmd.yaml"
    path.write_text(
        f"directives:\n- add_model:\n    name: mine\n    file: {OWN.urdf}\n- add_frame:\n"
        "    name: mine::sole\n    X_PF:\n      base_frame: mine::foot\n"
        "      translation: [0.0, 0.0, -0.01]\n"
    )
    leg, usual = (
        make_leg_model(replace(OWN, urdf=str(path), foot_frame="sole")),
        make_leg_model(OWN),
    )
    one, other = (model.place(model.make_context(), leg.posture) for model in (leg, usual))
    assert np.hypot(*(one - other)) == pytest.approx(0.01)
