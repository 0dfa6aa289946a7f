"""Links of a model stretched and weighed."""

from xml.etree.ElementTree import fromstring, tostring

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from parapod.diagrams.bodies import Body, BodyScenario, fit_link, in_si, place_joints
from parapod.diagrams.machining_centre.design import CentreDesign
from parapod.systems.core.errors import ScenarioError
from parapod.systems.machining_centre.geometry import CentreGeometry

# A box of 2 x 1 x 4 m off its frame, turned by a quarter where it is seen.
BOX = """<robot name="r"><link name="box">
  <inertial><origin xyz="1 2 3"/><mass value="6"/>
    <inertia ixx="8.5" ixy="0.2" ixz="-0.1" iyy="10" iyz="0.3" izz="2.5"/></inertial>
  <visual><origin xyz="1 2 3" rpy="1.5707963267948966 0 0"/>
    <geometry><cylinder radius="0.5" length="1"/></geometry></visual>
  <visual><geometry><sphere radius="1"/></geometry></visual>
  <visual><geometry><mesh filename="a.obj" scale="1 1 2"/></geometry></visual>
  <collision><origin xyz="1 2 3"/><geometry><box size="2 1 4"/></geometry></collision>
</link><link name="end"><inertial><mass value="1"/>
  <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="j" type="fixed"><parent link="box"/><child link="end"/>
  <origin xyz="1 2 3"/></joint></robot>"""
STRETCH = (2.0, 3.0, 0.5)


def second_moments(inertia):
    return 0.5 * np.trace(inertia) * np.eye(3) - inertia


def inertia_of(root):
    plant = MultibodyPlant(1e-3)
    link = root.find("link[@name='box']")
    for visual in link.findall("visual"):
        link.remove(visual)
    Parser(plant).AddModelsFromString(tostring(root, encoding="unicode"), "urdf")
    plant.Finalize()
    body = plant.GetBodyByName("box")
    central = body.default_spatial_inertia().Shift(body.default_com()).CalcRotationalInertia()
    return body.default_mass(), body.default_com(), central.CopyToFullMatrix3()


def test_second_moments_of_a_stretched_link_are_stretched_twice_and_its_mass_is_the_volume_s():
    before, root = inertia_of(fromstring(BOX)), fromstring(BOX)
    fit_link(root, "box", STRETCH, None)
    mass, centre, inertia = inertia_of(root)
    assert mass == pytest.approx(3.0 * before[0])
    assert centre == pytest.approx(np.multiply(STRETCH, before[1]))
    expected = 3.0 * np.outer(STRETCH, STRETCH) * second_moments(before[2])
    assert second_moments(inertia) == pytest.approx(expected)


def test_shapes_are_stretched_along_the_axes_of_the_link():
    root = fromstring(BOX)
    fit_link(root, "box", STRETCH, Body(1.0))
    cylinder, sphere, mesh = (
        root.find(f".//{name}").attrib for name in ("cylinder", "sphere", "mesh")
    )
    # Its axis is the link's second one; across it are the first and the third.
    assert float(cylinder["length"]) == pytest.approx(3.0)
    assert float(cylinder["radius"]) == pytest.approx(0.5 * np.sqrt(2.0 * 0.5))
    assert float(sphere["radius"]) == pytest.approx(3.0 ** (1 / 3))
    assert [float(x) for x in mesh["scale"].split()] == pytest.approx([2.0, 3.0, 1.0])
    box = root.find("link/collision/geometry/box").get("size").split()
    assert [float(x) for x in box] == pytest.approx([4.0, 3.0, 2.0])
    for origin in root.findall(".//visual/origin") + root.findall(".//collision/origin"):
        assert [float(x) for x in origin.get("xyz").split()] == pytest.approx([2.0, 6.0, 1.5])


def test_what_is_not_changed_stays_as_it_is_written():
    root = fromstring(BOX)
    fit_link(root, "box", (1.0, 1.0, 1.0), Body(6.0))
    place_joints(root, {"j": (1.0, 2.0 + 1e-14, 3.0)})
    assert tostring(root) == tostring(fromstring(BOX))
    place_joints(root, {"j": (2.0, 4.0, 6.0)})
    assert root.find("joint/origin").get("xyz") == "2.0 4.0 6.0"


def test_mass_centre_and_inertia_of_one_s_own_are_taken():
    root = fromstring(BOX)
    own = BodyScenario(2.0, [10.0, -20.0, 30.0], [1.0, 2.0, 2.5, 0.1, 0.2, 0.3]).body
    fit_link(root, "box", STRETCH, own)
    mass, centre, inertia = inertia_of(root)
    assert (mass, *centre) == pytest.approx((2.0, 0.01, -0.02, 0.03))
    assert inertia == pytest.approx(np.array(((1, 0.1, 0.2), (0.1, 2, 0.3), (0.2, 0.3, 2.5))))


def test_moments_of_no_body_are_refused_with_their_key():
    BodyScenario(1.0, None, [1.0, 1.0, 1.9, 0.0, 0.0, 0.0]).check("machine.tool")
    with pytest.raises(
        ScenarioError, match=r"machine\.tool\.inertia_kg_m2 = \[1, 1, 2\.1, 0"
    ) as e:
        BodyScenario(1.0, None, [1.0, 1.0, 2.1, 0.0, 0.0, 0.0]).check("machine.tool")
    assert e.value.key == "machine.tool.inertia_kg_m2"


def test_dimensions_of_a_scenario_are_those_of_the_dataclass_and_refused_by_their_key():
    assert in_si(CentreDesign(), CentreGeometry) == CentreGeometry()
    half = in_si(CentreDesign(half_angle_deg=30.0), CentreGeometry).half_angle
    assert half == pytest.approx(np.pi / 6)
    with pytest.raises(ScenarioError, match=r"stroke_min = 0\.7 m must be less than") as e:
        in_si(CentreDesign(stroke_min_mm=700.0), CentreGeometry)
    assert e.value.key == "machine.stroke_min_mm"
