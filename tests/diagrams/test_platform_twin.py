"""The platform's drawing by its signals: the rod of its arm bends as it is observed."""

import numpy as np
import pytest

from parapod.diagrams.levelling_platform.arms import FlexibleRod
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.view import PlatformTwin
from parapod.diagrams.twin import DESIRED, MEASURED
from parapod.systems.core.errors import WiringError

EXTENSION = np.full(4, 0.41)


def scenario_of(arm=None):
    scenario = LevellingScenario()
    if arm is not None:
        scenario.machine.arm = arm
    return scenario


def values(**more):
    return {
        "legs.extension": EXTENSION,
        "attitude_estimated": np.zeros(2),
        "arm.position": np.array([0.0, 0.5]),
        "arm.position_command": np.array([0.0, 0.5]),
    } | more


def places(twin, drawing=MEASURED):
    """Places (3) of the shapes that are drawn [m]."""
    graph, context = twin.scene_graphs()[drawing]
    query = graph.get_query_output_port().Eval(context)
    shapes = query.inspector().GetAllGeometryIds()
    return {shape: query.GetPoseInWorld(shape).translation().copy() for shape in shapes}


def ways(one, other):
    """Distance of each shape between two pictures [m]."""
    assert one.keys() == other.keys()
    return [np.linalg.norm(one[shape] - other[shape]) for shape in one]


@pytest.fixture(scope="module")
def twin():
    return PlatformTwin(None, scenario_of(FlexibleRod()))


def test_the_rod_bends_as_it_is_observed_and_nothing_else_moves(twin):
    rod = FlexibleRod().bending
    pictures = []
    for q in (0.0, 0.03):
        twin.show(values(rod_observed=np.array([q, *[0.0] * (4 * rod.modes - 1)])))
        pictures.append(places(twin))
    moved = ways(*pictures)
    tip = abs(0.03 * rod.shape(rod.length)[0])
    assert max(moved) == pytest.approx(tip, rel=0.1)
    still = [way for way in moved if way < 1e-12]
    assert len(moved) > len(still) > 0.3 * len(moved)


def test_a_rod_that_is_not_observed_sags_at_rest(twin):
    rod = FlexibleRod().bending
    twin.show(values(rod_observed=np.zeros(4 * rod.modes)))
    straight = places(twin)
    twin.show(values())
    sag = rod.sag(-9.81 * np.sin(0.5), 9.81 * np.cos(0.5))
    assert max(ways(straight, places(twin))) == pytest.approx(abs(sag.across), rel=0.1)


def test_what_is_asked_for_is_straight(twin):
    twin.show(values())
    before = places(twin, DESIRED)
    twin.show(values(rod_observed=np.full(8, 0.02)))
    assert max(ways(before, places(twin, DESIRED))) == 0.0


def test_the_rod_of_another_machine_is_refused(twin):
    with pytest.raises(WiringError, match=r"8 modal coordinates and rates, .* 12"):
        twin.show(values(rod_observed=np.zeros(12)))


def test_a_rigid_arm_is_drawn_as_ever():
    twin = PlatformTwin(None, scenario_of())
    twin.show(values())
    measured, desired = (
        sorted(np.round(place, 9).tolist() for place in places(twin, drawing).values())
        for drawing in (MEASURED, DESIRED)
    )
    assert measured == desired
