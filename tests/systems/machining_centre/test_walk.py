"""Plans of walks: every foot comes to where it was to go, by swings that can be made."""

import math
from functools import cache
from itertools import combinations

import numpy as np
import pytest

from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import (
    Job,
    Refused,
    check_footholds,
    check_job,
    standing,
    try_swing,
)
from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.swing import lock_sets
from parapod.systems.machining_centre.walk import Footprint, plan_walk

HEIGHT = 0.52
CYLINDER, PLANE = Panel(3.0), Panel(math.inf)
# Way of each foot along and across [m], number of its swings, panel.
WALKS = [
    ((0.05, 0.0), 1, CYLINDER),
    ((0.0, -0.06), 1, PLANE),
    ((-0.08, 0.06), 2, CYLINDER),
]


@cache
def planned(geometry, advance, steps, panel=CYLINDER, **options):
    job = Job(panel=panel)
    beginning = standing(geometry, panel, HEIGHT)
    return job, beginning, plan_walk(geometry, job, beginning, advance, steps, HEIGHT, **options)


@pytest.mark.parametrize(("advance", "steps", "panel"), WALKS)
def test_every_foot_comes_to_where_it_was_to_go(geometry, advance, steps, panel):
    job, beginning, swings = planned(geometry, advance, steps, panel)
    limbs = [swing.lock_set.limb for swing in swings]
    for step in range(steps):
        turn = limbs[step * geometry.limbs : (step + 1) * geometry.limbs]
        assert sorted(turn) == list(range(1, geometry.limbs + 1))
    begun, feet = Footprint.from_job(job, beginning.feet).places, beginning.feet
    for number, swing in enumerate(swings):
        limb = swing.lock_set.limb
        swung = try_swing(geometry, job, swing, feet)
        assert swung.sigma >= job.least_sigma
        assert swung.margin > 1e-3
        assert np.allclose(swung.way, swing.way, atol=1e-12)
        feet = swung.end.feet
        check_footholds(geometry, panel, feet)
        apart = [np.linalg.norm(a - b) for a, b in combinations(feet[:, :3], 2)]
        assert min(apart) >= geometry.foot_diameter
        gone = panel.place(feet[limb - 1, :3])[:2] - begun[limb - 1, :2]
        done = (number // geometry.limbs + 1) / steps
        assert np.allclose(gone, done * np.array(advance), atol=1e-9)
    ended = Footprint.from_job(job, feet).places
    assert np.allclose(ended[:, :2] - begun[:, :2], advance, atol=1e-9)


def test_a_quadruped_s_feet_keep_their_headings():
    geometry = CentreGeometry(4)
    job, beginning, swings = planned(geometry, (0.05, 0.0), 1)
    end = check_job(geometry, Job(tuple(swings), job.panel), beginning)
    before, after = (Footprint.from_job(job, feet).places for feet in (beginning.feet, end.feet))
    assert np.allclose(after[:, 2], before[:, 2], atol=1e-9)


def test_a_footprint_has_ways_and_headings_of_a_tripod_that_has_turned():
    geometry, panel = CentreGeometry(3), Panel(3.0)
    feet = np.array([panel.frame(0.1 * k, -0.2 * k, 0.3 * k) for k in range(3)])
    expected = [(0.1 * k, -0.2 * k, 0.3 * k) for k in range(3)]
    assert np.allclose(Footprint.from_job(Job(panel=panel), feet).places, expected, atol=1e-12)
    assert geometry.limbs == 3


def test_the_platform_begins_its_swings_over_its_feet_and_level(geometry):
    job, _, swings = planned(geometry, (0.05, 0.0), 1)
    for swing in swings:
        assert job.panel.tilt(swing.pose) < 1e-9
        along, across, height = job.panel.place(swing.pose[:3])
        assert np.hypot(along, across) < 0.08
        assert abs(height - HEIGHT) < 0.0601
        # A tripod's feet turn, and with them the pattern that is nearest.
        assert abs(job.panel.heading(swing.pose)) < 0.3


def test_the_best_locks_are_of_those_that_there_are():
    geometry = CentreGeometry(3)
    for swing in planned(geometry, (0.05, 0.0), 1)[2]:
        assert swing.lock_set in lock_sets(geometry, swing.lock_set.limb)


def test_locks_that_are_named_are_taken_after_the_loose_limb():
    geometry = CentreGeometry(3)
    _, _, swings = planned(geometry, (0.05, 0.0), 1, locked=((1, 3), (2, 6)))
    assert {swing.lock_set.limb: swing.lock_set.standing for swing in swings} == {
        1: ((2, 3), (3, 6)),
        2: ((1, 6), (3, 3)),
        3: ((1, 3), (2, 6)),
    }


def test_the_paper_s_locks_are_refused_of_a_level_tripod_in_words():
    with pytest.raises(
        Refused,
        match=r"no walk is found, step 1 of 2: limb 1 would swing past a singularity: .* "
        r"lock other joints than q1 of 2, q1 of 3",
    ):
        planned(CentreGeometry(3), (0.1, 0.0), 2, locked=((1, 1), (2, 1)))


def test_a_walk_that_is_too_far_is_refused_with_its_step():
    with pytest.raises(Refused, match="no walk is found, step 1 of 1: "):
        planned(CentreGeometry(4), (0.6, 0.0), 1)


def test_a_swing_that_only_seems_to_do_is_passed_over():
    # From the first pose that seems good the drill would come too near to the panel.
    geometry = CentreGeometry(4)
    job, beginning, swings = planned(geometry, (0.2, 0.0), 1)
    check_job(geometry, Job(tuple(swings), job.panel), beginning)
