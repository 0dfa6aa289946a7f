"""The support polygon, through a gait, and its monitor."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.walking_chair.gait import DIRECTIONS, ORDERS, TrotGait, Walk, there_and_back
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import ChairMasses, Passenger
from parapod.systems.walking_chair.support import (
    GaitSupport,
    SupportLost,
    SupportMonitor,
    SupportMonitorParams,
    support_polygon,
)

SQUARE = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]


@pytest.mark.parametrize(
    ("point", "margin"),
    [
        ((0.0, 0.0), 1.0),
        ((0.7, 0.2), 0.3),
        ((-0.2, -0.9), 0.1),
        ((1.0, 0.0), 0.0),
        ((1.25, 0.0), -0.25),
        ((0.0, -3.0), -2.0),
    ],
)
def test_margin_is_the_distance_to_the_nearest_edge(point, margin):
    assert support_polygon(SQUARE).margin(point) == pytest.approx(margin, abs=1e-15)


def test_three_contacts_support_a_triangle():
    triangle = support_polygon([(0.0, 0.0), (3.0, 0.0), (0.0, 4.0)])
    assert triangle.margin((1.0, 1.0)) == pytest.approx(1.0)  # the centre of its incircle


def test_points_inside_and_on_edges_do_not_matter():
    polygon = support_polygon([*SQUARE, (0.0, 0.0), (0.3, -0.2), (1.0, 0.0), (0.9, 0.9)])
    assert len(polygon.corners) == 4
    assert polygon.margin((0.5, 0.0)) == pytest.approx(0.5)


def test_corners_go_round_anticlockwise_and_normals_outwards():
    random = np.random.default_rng(0)
    polygon = support_polygon(random.normal(size=(20, 2)))
    a, b = polygon.corners, np.roll(polygon.corners, -1, axis=0)
    area = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
    assert area > 0.0
    np.testing.assert_allclose(np.linalg.norm(polygon.normals, axis=1), 1.0)
    inside = polygon.corners.mean(axis=0)
    assert (polygon.normals @ inside < polygon.offsets).all()


def test_margin_turns_and_moves_with_the_contacts():
    random = np.random.default_rng(1)
    contacts, point = random.normal(size=(8, 2)), random.normal(size=2)
    angle = 0.7
    turn = np.array(((math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))))
    moved = support_polygon(contacts @ turn.T + (3.0, -2.0)).margin(turn @ point + (3.0, -2.0))
    assert moved == pytest.approx(support_polygon(contacts).margin(point), abs=1e-14)


@pytest.mark.parametrize(
    "contacts",
    [
        [],
        [(0.0, 0.0)],
        [(0.0, 0.0), (1.0, 0.0)],
        [(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)],
        [(0.0, 0.0), (1.0, 0.0), (math.nan, 1.0)],
    ],
)
def test_without_a_polygon_nothing_is_supported(contacts):
    assert support_polygon(contacts).margin((0.0, 0.0)) == -math.inf


@pytest.mark.parametrize("point", [(math.nan, 0.0), (math.inf, 0.0)])
def test_a_point_that_is_not_finite_is_not_supported(point):
    assert support_polygon(SQUARE).margin(point) == -math.inf


CHAIR, GAIT = ChairGeometry(), TrotGait()
MASSES = ChairMasses()
# All of the chair's mass at S.
AT_S = replace(MASSES, body=MASSES.body + 4 * MASSES.foot_end, foot=0.0, rod=0.0)
CENTRED = Passenger()


def support_of(gait=GAIT, masses=AT_S):
    return GaitSupport(CHAIR, Walk((gait,)), masses)


def test_margins_of_the_papers_gait():
    margins = 1e3 * support_of().margins(CENTRED)
    expected = (215.0, 57.05, 154.6, 57.05, 215.0)
    np.testing.assert_allclose(margins, expected, atol=0.05)


def test_swinging_feet_take_the_centre_towards_the_edge():
    margins = 1e3 * support_of(masses=MASSES).margins(CENTRED)
    # Two feet of 2 kg a step ahead, against the edge's normal.
    lost = 0.6685 * 2.0 * 2.0 * 102.7 / 106.2
    assert margins[1] == pytest.approx(57.05 - lost, abs=0.05)
    assert margins[3] == pytest.approx(57.05 - lost, abs=0.05)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_margin_is_the_same_for_every_order_and_direction(order, direction):
    gait = TrotGait(order=order, direction=direction)
    assert support_of(gait).margins(CENTRED).min() == pytest.approx(0.05705, abs=5e-5)


def test_margin_does_not_depend_on_the_body_s_law():
    margins = [
        support_of(replace(GAIT, body_law=law)).margins(CENTRED) for law in ("linear", "ramped")
    ]
    np.testing.assert_allclose(margins[0], margins[1], atol=1e-9)


@pytest.mark.parametrize("place", [(0.04, 0.0), (0.0, 0.03), (-0.05, -0.02), (0.03, -0.03)])
def test_a_payload_aside_costs_its_share_of_the_margin(place):
    passenger = Passenger(x=place[0], y=place[1])
    first = support_of().margin(1, passenger)
    # Both long edges are as far from S; the nearer one is that on the payload's side.
    cost = 57.0 / 106.2 * abs(np.dot((0.7437, 0.6685), place))
    assert first == pytest.approx(0.05705 - cost, abs=1e-4)


def test_a_payload_beyond_the_edge_has_a_negative_margin():
    assert support_of().margin(1, Passenger(x=0.2)) < 0.0


def test_cycles_and_the_way_back_have_the_margins_of_the_first():
    walk = there_and_back(replace(GAIT, cycles=3))
    margins = GaitSupport(CHAIR, walk, AT_S).margins(CENTRED)
    assert len(margins) == len(walk.phases)
    for name in set(walk.phases):
        same = margins[[phase == name for phase in walk.phases]]
        assert np.ptp(same) < 1e-9, name


def test_polygon_of_two_feet_is_spanned_by_their_corners():
    polygon = support_of().polygon(1)
    assert len(polygon.corners) == 6 - 2
    normals = np.abs(polygon.normals)
    assert np.isclose(normals, (0.7437, 0.6685), atol=1e-4).all(axis=1).sum() == 2
    # E2 of leg 4 and E3 of leg 2 are the widest.
    np.testing.assert_allclose(np.abs(polygon.corners[:, 0]).max(), 0.215)


def test_polygon_of_a_shift_has_only_the_corners_that_stay_on_the_ground():
    polygon = support_of().polygon(2)
    assert len(polygon.corners) == 4
    x = np.sort(polygon.corners[:, 0])
    # On the left E1 of legs 1 and 4, on the right edges of legs 2 and 3.
    np.testing.assert_allclose(x, (-0.155, -0.155, 0.215, 0.215), atol=1e-9)


def test_a_margin_that_suffices_is_accepted():
    support_of().check(CENTRED, 0.057)
    support_of().check(Passenger(mass=0.0), 0.057)


def test_support_that_is_lost_names_phase_time_and_millimetres():
    with pytest.raises(SupportLost) as caught:
        support_of().check(CENTRED, 0.060)
    error = caught.value
    assert error.phase == "first swing"
    assert error.time == 5.0
    assert error.required == 0.060
    assert error.margin == pytest.approx(0.05705, abs=5e-5)
    assert str(error) == (
        "the first swing that begins 5 s after the start would have a support margin of 57.0 mm, "
        "less than the 60.0 mm that are required"
    )


def test_the_worst_phase_is_the_one_that_is_named():
    # To the right and behind: the second swing's nearest edge.
    with pytest.raises(SupportLost) as caught:
        support_of().check(Passenger(x=0.10, y=-0.08), 0.010)
    assert (caught.value.phase, caught.value.time) == ("second swing", 15.0)
    assert caught.value.margin < 0.0


def test_a_payload_that_is_not_finite_is_refused():
    with pytest.raises(SupportLost):
        support_of().check(Passenger(x=np.nan), 0.0)


WALK = Walk((TrotGait(),))
MARGINS = GaitSupport(ChairGeometry(), WALK).margins


def start(fix, payload, gait_time=0.0, **params):
    monitor = SupportMonitor(WALK, SupportMonitorParams(**params), period=0.1)
    simulator = Simulator(monitor)
    context = simulator.get_mutable_context()
    fix(monitor, context, gait_time=(gait_time,), payload=payload)
    return monitor, simulator, context


def shown(monitor, context, name):
    return monitor.GetOutputPort(name).Eval(context)[0]


@pytest.mark.parametrize(("time", "phases"), [(1.0, (0, 1)), (6.0, (1, 2)), (11.0, (2, 3))])
def test_margin_is_the_smallest_of_this_phase_and_the_next(fix, time, phases):
    passenger = Passenger(57.0, 0.05, 0.02)
    monitor, _, context = start(fix, (57.0, 0.05, 0.02), time)
    expected = MARGINS(passenger)[list(phases)].min()
    assert shown(monitor, context, "margin") == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("time", [-1.0, 23.0, 25.0, 60.0])
def test_before_and_after_the_walk_its_ends_count(fix, time):
    monitor, _, context = start(fix, (57.0, 0.0, 0.0), time)
    margins = MARGINS(Passenger(57.0))
    expected = margins[:2].min() if time < 0.0 else margins[-1]
    assert shown(monitor, context, "margin") == pytest.approx(expected, abs=1e-12)


def test_too_little_margin_holds_the_gait(fix):
    monitor, simulator, context = start(fix, (57.0, 0.0, 0.0))
    simulator.AdvanceTo(0.15)
    assert shown(monitor, context, "hold") == 0.0
    fix(monitor, context, payload=(57.0, 0.10, 0.05))
    simulator.AdvanceTo(0.35)
    assert shown(monitor, context, "margin") < 0.0
    assert shown(monitor, context, "hold") == 1.0


def test_a_hold_ends_only_with_some_margin_more(fix):
    monitor, simulator, context = start(fix, (57.0, 0.0, 0.0), required=0.03, regained=0.01)
    edge = [x for x in np.linspace(0.0, 0.1, 2001) if MARGINS(Passenger(57.0, x))[1] >= 0.03][-1]
    holds = []
    for k, x in enumerate((edge + 1e-3, edge - 1e-3, edge - 0.03)):
        fix(monitor, context, payload=(57.0, x, 0.0))
        simulator.AdvanceTo(0.05 + 0.2 * (k + 1))
        holds.append(shown(monitor, context, "hold"))
    assert holds == [1.0, 1.0, 0.0]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("index", [0, 1, 2])
def test_a_payload_that_is_not_finite_holds_the_gait(fix, index, bad):
    payload = np.array((57.0, 0.0, 0.0))
    payload[index] = bad
    monitor, simulator, context = start(fix, payload)
    simulator.AdvanceTo(0.15)
    assert shown(monitor, context, "margin") == -math.inf
    assert shown(monitor, context, "hold") == 1.0
