"""Jobs are refused as a whole, in words that name what does not fit and what would."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import (
    LARGEST_LEAN,
    Drill,
    Job,
    Process,
    Refused,
    Swing,
    carried,
    check_drill,
    check_footholds,
    check_job,
    drills,
    row_of_holes,
    standing,
    swung_to,
    try_swing,
)
from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.paths import Speeds, foot_at
from parapod.systems.machining_centre.platform_mode import displacement, jacobian, leg_lengths
from parapod.systems.machining_centre.statics import CentreMasses
from parapod.systems.machining_centre.swing import LockSet, close_locks, lock_conditions

TRIPOD, QUADRUPED = CentreGeometry(3), CentreGeometry(4)
PANEL = Panel(3.0)
# A tripod that is level cannot swing with the paper's locks; with these it can.
GOOD_LOCKS = LockSet(1, ((2, 3), (3, 6)))


def locks_of(geometry):
    return GOOD_LOCKS if geometry.limbs == 3 else LockSet(1)


def beginning_of(geometry, panel=PANEL):
    return standing(geometry, panel, 0.52)


def hole(along=0.0, across=0.0, tilt=0.1, depth=0.004, panel=PANEL):
    (drill,) = row_of_holes(panel, (along, across), 0.5, 1, 0.03, tilt=tilt, depth=depth)
    return drill


def step_of(geometry, along=0.03, lock_set=None, pose=None):
    """A swing of limb 1 outwards."""
    foothold = PANEL.foothold(geometry.pattern_radius + along, 0.0)
    pose = beginning_of(geometry).pose if pose is None else pose
    return Swing(pose, lock_set or locks_of(geometry), foothold)


def refused(geometry, *operations, job=Job(panel=PANEL), beginning=None):
    job = replace(job, operations=operations)
    with pytest.raises(Refused) as found:
        check_job(geometry, job, beginning or beginning_of(geometry))
    return found.value


# What is done


def test_a_job_ends_where_its_last_operation_does(geometry):
    operations = (hole(), step_of(geometry), hole(0.01, 0.02))
    beginning = beginning_of(geometry)
    end = check_job(geometry, Job(operations, PANEL), beginning)
    process = Process()
    assert np.allclose(end.pose, operations[2].pose(process, process.clearance), atol=1e-15)
    assert np.allclose(end.feet[0, :3], operations[1].foothold[:3], atol=1e-12)
    assert np.array_equal(end.feet[1:], beginning.feet[1:])
    between = check_job(geometry, Job(operations[:2], PANEL), beginning)
    again = check_job(geometry, Job(operations[2:], PANEL), between)
    assert np.array_equal(again.pose, end.pose)
    assert np.array_equal(again.feet, end.feet)
    assert drills(operations) == 2


def test_a_swing_on_paper_keeps_its_locks_and_comes_to_its_foothold(geometry):
    beginning, swing = beginning_of(geometry), step_of(geometry)
    swung = try_swing(geometry, Job(panel=PANEL), swing, beginning.feet)
    locks = close_locks(geometry, swing.pose, swing.lock_set, beginning.feet, along="left")
    again = close_locks(geometry, swung.end.pose, swing.lock_set, swung.end.feet, along="left")
    assert np.allclose(again.values, locks.values, atol=1e-7)
    assert PANEL.tilt(swung.end.feet[0]) < 1e-9
    assert np.allclose(swung.way[0], swing.pose, atol=1e-9)
    assert np.array_equal(swung.way[-1], swung.end.pose)
    lengths = leg_lengths(geometry, swung.end.pose, swung.end.feet)
    room = min(lengths.min() - geometry.stroke_min, geometry.stroke_max - lengths.max())
    assert 0.0 < swung.margin <= room + 1e-12
    turns = geometry.limbs == 3
    for pose, feet in ((swing.pose, beginning.feet), swung.end):
        at = lock_conditions(geometry, pose, swing.lock_set, feet, along="left", turns=turns)
        assert swung.sigma <= min(at.inverse, at.holding) + 1e-9


def test_more_looks_find_no_more_room(geometry):
    feet, swing, job = beginning_of(geometry).feet, step_of(geometry), Job(panel=PANEL)
    few, many = (try_swing(geometry, job, swing, feet, looks) for looks in (4, 32))
    assert many.margin <= few.margin + 3e-3
    assert many.sigma <= few.sigma + 3e-3
    assert len(many.way) == 33


def test_a_swing_is_followed_from_one_moment_to_the_next(geometry):
    beginning, swing = beginning_of(geometry), step_of(geometry)
    locks = close_locks(geometry, swing.pose, swing.lock_set, beginning.feet, along="left")
    by = displacement(beginning.feet[0], swing.foothold)
    pose, feet = swing.pose, beginning.feet.copy()
    for share in np.linspace(0.0, 1.0, 60):
        foot = foot_at(beginning.feet[0], swing.foothold, by, 0.03, share)
        found = swung_to(geometry, locks, foot, pose)
        pose, feet[0] = found.pose, found.foot_pose
        assert np.allclose(feet[0, :3], foot[:3], atol=1e-15)
        assert np.allclose(found.lengths, leg_lengths(geometry, pose, feet), atol=1e-14)
        values = close_locks(geometry, pose, swing.lock_set, feet, along="left").values
        assert np.allclose(values, locks.values, atol=1e-4)


def test_the_drill_s_tip_is_where_the_hole_is():
    process, drill = Process(), hole(0.2, -0.1, tilt=0.2)
    out = Rotation.from_euler("xyz", drill.hole[3:]).as_matrix()[:, 2]
    for height in (0.01, 0.0, -0.004):
        pose = drill.pose(process, height)
        assert np.allclose(process.tip(pose), drill.hole[:3] + height * out, atol=1e-15)
    poses = np.stack([drill.pose(process, height) for height in (0.0, 0.1)])
    assert np.allclose(process.tip(poses)[1], drill.hole[:3] + 0.1 * out, atol=1e-15)


def test_the_wrench_is_that_of_drill_and_weight_along_the_platform_s_axis():
    process, pose = Process(thrust=200.0, torque=3.0), hole(tilt=0.2).pose(Process(), 0.0)
    out = Rotation.from_euler("xyz", pose[3:]).as_matrix()[:, 2]
    wrench = process.wrench(TRIPOD, pose)
    assert np.allclose(wrench[:3], 3.0 * out)
    assert np.allclose(wrench[3:], 200.0 * out - (0.0, 0.0, 9.81 * (10.2 + 1.5 * 5.2)))


def test_what_is_carried_is_carried_by_legs_within_their_force(geometry):
    # The nearest facet of what legs of that force resist, by their forces in its direction.
    rng, process = np.random.default_rng(0), Process()
    for drill in (hole(), hole(0.05, 0.03, tilt=0.2)):
        pose, feet = drill.pose(process, 0.0), beginning_of(geometry).feet
        found = carried(geometry, process, pose, feet)
        rows = jacobian(geometry, pose, feet) / np.repeat((geometry.platform_radius, 1.0), 3)
        for direction in rng.normal(size=(50, 6)):
            direction /= np.linalg.norm(direction)
            most = process.largest_leg_force * np.abs(rows @ direction).sum()
            assert found.capacity <= most
        wrench = process.wrench(geometry, pose)
        wrench[:3] /= geometry.platform_radius
        assert found.needed == pytest.approx(np.linalg.norm(wrench))


def test_rows_of_holes_have_their_pitch_direction_and_lean():
    holes = row_of_holes(PANEL, (0.1, -0.05), 0.7, 3, 0.03, tilt=0.15, depth=0.006, yaw=0.4)
    places = np.array([PANEL.place(drill.hole[:3]) for drill in holes])
    assert np.allclose(places[1], (0.1, -0.05, 0.0), atol=1e-15)
    steps = np.diff(places, axis=0)
    assert np.allclose(steps, 0.03 * np.array((np.cos(0.7), np.sin(0.7), 0.0)), atol=1e-14)
    for drill, (along, across, _) in zip(holes, places, strict=True):
        here = Rotation.from_euler("xyz", PANEL.frame(along, across)[3:])
        own = here.inv() * Rotation.from_euler("xyz", drill.hole[3:])
        lean = np.sin(0.15) * np.array((np.cos(0.7), np.sin(0.7)))
        assert np.allclose(own.as_matrix()[:2, 2], lean, atol=1e-12)
        assert drill.depth == 0.006
    level = row_of_holes(PANEL, (0.1, 0.0), 0.7, 1, 0.03, yaw=0.4)[0]
    assert PANEL.heading(level.hole) == pytest.approx(0.4)
    assert PANEL.tilt(level.hole) == pytest.approx(0.0, abs=1e-12)


def test_a_centre_stands_on_the_panel_in_the_paper_s_pattern(geometry):
    posture = standing(geometry, PANEL, 0.47)
    check_footholds(geometry, PANEL, posture.feet)
    places = PANEL.place(posture.feet[:, :3])
    assert np.allclose(np.hypot(places[:, 0], places[:, 1]), geometry.pattern_radius)
    assert np.allclose(places[:, 2], PANEL.foot_height, atol=1e-15)
    assert np.allclose(posture.pose, (0.0, 0.0, 0.47, 0.0, 0.0, 0.0), atol=1e-15)
    flat = standing(geometry, Panel(math.inf), 0.47).feet
    flat[:, 2] -= PANEL.foot_height
    assert np.allclose(displacement(flat, geometry.footholds), 0.0, atol=1e-15)


# What is refused


def test_a_hole_out_of_reach_is_refused_with_its_number_its_place_and_the_leg(geometry):
    flat = Panel(math.inf)
    found = refused(
        *(geometry, hole(panel=flat), hole(0.5, panel=flat)),
        job=Job(panel=flat),
        beginning=beginning_of(geometry, flat),
    )
    assert found.operation == 2
    assert re.search(
        r"operation 2: \(\d+, .* mm, .* deg is out of reach: .* of limb \d", str(found)
    )


def test_a_hole_that_is_too_deep_for_the_legs_is_refused(geometry):
    feet, job = beginning_of(geometry).feet, Job(panel=PANEL)
    check_drill(geometry, job, hole(depth=0.01), feet)
    with pytest.raises(Refused, match="is out of reach"):
        check_drill(geometry, job, hole(depth=0.1), feet)


@pytest.mark.parametrize("tilt", [0.0, 0.1, 0.25])
@pytest.mark.parametrize("thrust", [1500.0, 3000.0])
def test_a_thrust_that_would_do_is_carried_and_one_percent_more_is_not(geometry, thrust, tilt):
    feet, drill = beginning_of(geometry).feet, hole(tilt=tilt, depth=0.01)

    def job(thrust):
        return Job(panel=PANEL, process=Process(thrust=thrust, torque=2.0))

    with pytest.raises(Refused) as found:
        check_drill(geometry, job(thrust), drill, feet)
    match = re.fullmatch(
        r"at (\(.*\) mm, \(.*\) deg) legs of 1000 N resist (\d+) N in every direction "
        r"\(w_minmax (0\.\d{4})\), and drill and weight need (\d+) N: "
        r"a thrust of (\d+) N would do",
        found.value.words,
    )
    capacity, index, needed, enough = (float(match[k]) for k in (2, 3, 4, 5))
    assert needed > capacity
    assert capacity == pytest.approx(index * geometry.legs * 1000.0, rel=1e-3)
    assert 300.0 < enough < thrust
    check_drill(geometry, job(enough), drill, feet)
    with pytest.raises(Refused, match="would do"):
        check_drill(geometry, job(1.01 * enough + 1.0), drill, feet)


def test_legs_that_do_not_carry_the_weight_alone_are_refused(geometry):
    # The drill's thrust is up: with it less would be needed.
    down = np.linalg.norm(CentreMasses().weight(geometry))
    process = Process(thrust=down, torque=0.0, largest_leg_force=100.0)
    feet, drill = beginning_of(geometry).feet, hole(tilt=0.0)
    found = carried(geometry, process, drill.pose(process, 0.0), feet)
    assert found.needed < 0.1 * down
    with pytest.raises(Refused, match=rf"the weight alone needs {down:.0f} N: no thrust would do"):
        check_drill(geometry, Job(panel=PANEL, process=process), drill, feet)
    enough = 1.05 * 100.0 * down / found.capacity
    stronger = replace(process, largest_leg_force=enough)
    check_drill(geometry, Job(panel=PANEL, process=stronger), drill, feet)


def test_legs_that_do_not_carry_the_weight_on_the_way_are_refused_with_those_that_would(geometry):
    # Thrust up and by half: the holes themselves ask for less than the weight.
    def job(force):
        down = np.linalg.norm(CentreMasses().weight(geometry))
        return Job(
            panel=PANEL, process=Process(thrust=0.5 * down, torque=0.0, largest_leg_force=force)
        )

    error = refused(geometry, hole(tilt=0.0), job=job(50.0))
    assert error.operation == 1
    match = re.fullmatch(
        r"on the way, at (\(.*\) mm, \(.*\) deg), legs of 50 N resist (\d+) N in every direction, "
        r"and the weight needs (\d+) N: legs of (\d+) N would do",
        error.words,
    )
    capacity, weight, enough = (float(match[k]) for k in (2, 3, 4))
    assert enough == pytest.approx(50.0 * weight / capacity, rel=0.02)
    check_job(
        geometry, replace(job(enough + 1.0), operations=(hole(tilt=0.0),)), beginning_of(geometry)
    )
    refused(geometry, hole(tilt=0.0), job=job(enough - 1.0))


def test_footholds_that_overlap_are_refused_with_both_limbs(geometry):
    feet = beginning_of(geometry).feet
    along, across, _ = PANEL.place(feet[1, :3])
    feet[2] = PANEL.foothold(along, across - 1.01 * geometry.foot_diameter)
    check_footholds(geometry, PANEL, feet)
    feet[2] = PANEL.foothold(along, across - 0.98 * geometry.foot_diameter)
    with pytest.raises(Refused, match=r"limbs 2 and 3 overlap: 98 mm .* 100 are needed"):
        check_footholds(geometry, PANEL, feet)


@pytest.mark.parametrize("height", [2e-3, -2e-3])
def test_footholds_off_the_panel_are_refused_with_the_limb(geometry, height):
    feet = beginning_of(geometry).feet
    feet[1] = PANEL.frame(-0.1, 0.15, height=PANEL.foot_height + 0.9e-3)
    check_footholds(geometry, PANEL, feet)
    feet[1] = PANEL.frame(-0.1, 0.15, height=PANEL.foot_height + height)
    says = rf"the foothold of limb 2 is {1e3 * height:.1f} mm off the panel"
    with pytest.raises(Refused, match=says):
        check_footholds(geometry, PANEL, feet)


@pytest.mark.parametrize("element", range(6))
def test_footholds_that_are_not_finite_are_refused_with_the_limb(geometry, element):
    feet = beginning_of(geometry).feet
    feet[1, element] = math.nan
    with pytest.raises(Refused, match="the foothold of limb 2 is not finite"):
        check_footholds(geometry, PANEL, feet)


def test_footholds_that_face_away_are_refused_with_their_lean(geometry):
    feet = beginning_of(geometry).feet
    for lean, is_refused in ((0.98 * LARGEST_LEAN, False), (1.02 * LARGEST_LEAN, True)):
        own = Rotation.from_euler("xyz", feet[0, 3:]) * Rotation.from_rotvec((0.0, lean, 0.0))
        leaning = feet.copy()
        leaning[0, 3:] = own.as_euler("xyz")
        if is_refused:
            with pytest.raises(Refused, match=r"limb 1 faces away: its axis leans 2\.9 deg"):
                check_footholds(geometry, PANEL, leaning)
        else:
            check_footholds(geometry, PANEL, leaning)


def test_a_beginning_or_a_swing_to_bad_footholds_is_refused(geometry):
    beginning = beginning_of(geometry)
    lifted = beginning.feet.copy()
    lifted[1, 2] += 0.01
    found = refused(geometry, hole(), beginning=beginning._replace(feet=lifted))
    assert found.operation == 0
    assert str(found).startswith("the beginning: the foothold of limb 2 is")
    near = replace(step_of(geometry), foothold=beginning.feet[1])
    found = refused(geometry, hole(), near)
    assert str(found).startswith("operation 2: the footholds of limbs 1 and 2 overlap: 0 mm")
    low = beginning._replace(pose=beginning.pose - (0.0, 0.0, 0.2, 0.0, 0.0, 0.0))
    assert "the beginning: (0, 0, 320) mm" in str(refused(geometry, beginning=low))


def test_a_swing_past_a_singularity_names_the_locks():
    found = refused(TRIPOD, step_of(TRIPOD, lock_set=LockSet.printed(TRIPOD, 1)))
    assert re.search(
        r"limb 1 would swing past a singularity: the smallest singular value is 0\.00\d, and "
        r"0\.05 are needed; lock other joints than q1 of 2, q1 of 3",
        found.words,
    )


def test_as_much_of_the_singular_value_is_needed_as_is_said(geometry):
    feet, swing = beginning_of(geometry).feet, step_of(geometry)
    sigma = try_swing(geometry, Job(panel=PANEL), swing, feet).sigma
    for needed, is_refused in ((0.99 * sigma, False), (1.01 * sigma, True)):
        job = Job(panel=PANEL, least_sigma=needed)
        if is_refused:
            with pytest.raises(Refused, match="past a singularity"):
                try_swing(geometry, job, swing, feet)
        else:
            try_swing(geometry, job, swing, feet)


def test_locks_that_do_not_fit_are_refused():
    found = refused(TRIPOD, step_of(TRIPOD, lock_set=LockSet(1)))
    assert "2 joints of standing limbs must be locked, not 0" in str(found)
    found = refused(QUADRUPED, step_of(QUADRUPED, lock_set=LockSet(1, ((1, 2),))))
    assert "joint 2 of limb 1 cannot be locked" in str(found)


def test_a_swing_that_is_too_far_is_refused(geometry):
    found = refused(geometry, step_of(geometry, along=0.5))
    assert "operation 1: " in str(found)
    assert re.search(r"outside its stroke|cannot swing so|tip would be|singularity", str(found))


@pytest.mark.parametrize("which", ["rapid", "swing"])
def test_legs_that_are_too_fast_name_a_speed_that_would_do(geometry, which):
    quick = Speeds(rapid=0.5, turn=9.0, swing=0.5, acceleration=1e3, leg=0.02)
    operation = hole(0.05, 0.0, tilt=0.0) if which == "rapid" else step_of(geometry, 0.06)
    found = refused(geometry, operation, job=Job(panel=PANEL, speeds=quick, drift=0.0))
    match = re.search(
        r"the (left|right) leg of limb \d would have to go at (\d+) mm/s and may go at 20: "
        rf"a {which} speed that is (\d+\.\d\d) times lower would do",
        found.words,
    )
    assert float(match[2]) / 20.0 == pytest.approx(float(match[3]), abs=0.1)
    for share, is_refused in ((1.03, False), (0.97, True)):
        slower = replace(quick, **{which: 0.5 / (share * float(match[3]))})
        job = Job((operation,), PANEL, speeds=slower, drift=0.0)
        if is_refused:
            assert which in str(refused(geometry, operation, job=job))
        else:
            check_job(geometry, job, beginning_of(geometry))


def test_a_way_of_the_drill_through_the_panel_is_refused(geometry):
    # Straight from one hole to the other, over a panel that is higher in between.
    bent = Panel(0.6)
    beginning = beginning_of(geometry, bent)
    holes = [hole(along, tilt=0.0, panel=bent) for along in (-0.06, 0.06)]
    # The platform goes straight, and is higher by the tool's length.
    sagitta = (0.6 + Process().tool_length) * (1.0 - math.cos(0.1))
    for clearance in (1.8 * sagitta, 2.4 * sagitta):
        job = Job(panel=bent, process=Process(clearance=clearance))
        if clearance < 2.0 * sagitta:
            found = refused(geometry, *holes, job=job, beginning=beginning)
            assert re.search(
                r"operation 2: the drill's tip would be [\d.]+ mm above the panel with the "
                r"platform at .*: [\d.]+ mm are needed",
                str(found),
            )
        else:
            check_job(geometry, replace(job, operations=tuple(holes)), beginning)


def test_a_swing_that_drives_the_drill_into_the_panel_is_refused(geometry):
    beginning = beginning_of(geometry)
    # 7 mm are enough on a way, and less than the 10 mm of a drill that is retracted.
    for height, is_refused in ((0.490, False), (0.487, True), (0.483, True)):
        pose = PANEL.frame(0.0, 0.0, height=height)
        swing = step_of(geometry, along=0.0, pose=pose)
        if is_refused:
            with pytest.raises(Refused, match=r"the drill's tip would be -?[\d.]+ mm above"):
                try_swing(geometry, Job(panel=PANEL, drift=0.0), swing, beginning.feet)
        else:
            try_swing(geometry, Job(panel=PANEL, drift=0.0), swing, beginning.feet)


def test_a_drill_s_number_counts_from_one():
    assert str(Refused("no", 3)) == "operation 3: no"
    assert str(Refused("no")) == "no"
    assert isinstance(hole(), Drill)
