import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from parapod.systems.machining_centre.drilling import DrillingProcess
from parapod.systems.machining_centre.job import Drill, Process, row_of_holes
from parapod.systems.machining_centre.panel import Panel

PROCESS, PANEL, PERIOD, FEED = Process(thrust=150.0, torque=0.6), Panel(3.0), 0.01, 0.003
(HOLE,) = row_of_holes(PANEL, (0.05, -0.02), 0.5, 1, 0.03, tilt=0.0)
# The drill's point is in the material from here on, and loads have come [m, s].
DEEP, LAGS = 2.5e-3, 10 * 0.02


@pytest.fixture
def drill(stand):
    class Tool(stand):
        """A drill that is fed at its tip's heights above the panel."""

        def at(self, height, hole=HOLE):
            return self.tick(pose=hole.pose(PROCESS, height))

        def feed(self, start, end, speed):
            for k in range(1, round(abs(end - start) / speed / PERIOD) + 1):
                self.at(start + np.sign(end - start) * k * speed * PERIOD)
            return self

    return lambda: Tool(DrillingProcess(PROCESS, PANEL, FEED, PERIOD), pose=np.zeros(6))


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0, 1.4])
def test_load_is_in_proportion_to_the_feed(drill, share):
    machine = drill()
    machine.feed(0.002, -DEEP, share * FEED)
    machine.feed(-DEEP, -DEEP - LAGS * share * FEED, share * FEED)
    assert machine["tool_force"] == pytest.approx((150.0 * share, 0.6 * share), rel=1e-3)


def test_load_has_an_end(drill):
    assert drill().feed(0.0, -0.03, 4.0 * FEED)["tool_force"][0] == pytest.approx(225.0, rel=1e-2)


def test_load_grows_until_the_point_is_in(drill):
    machine, loads = drill(), []
    for k in range(1, 67):
        loads.append(machine.at(-k * FEED * PERIOD)["tool_force"][0])
    assert loads[0] < 2.0
    assert (np.diff(loads) > 0.0).all()
    # Half of the point is in, a lag ago.
    assert loads[33] == pytest.approx(75.0 * (1.0 - 0.02 / 0.34), rel=0.05)


def test_a_tip_that_stays_or_goes_back_is_free(drill):
    machine = drill().feed(0.0, -0.004, FEED)
    assert machine["tool_force"][0] > 100.0
    machine.wait(LAGS)
    assert np.abs(machine["tool_force"]).max() < 0.02
    machine.feed(-0.004, 0.0005, 2.0 * FEED)
    assert (np.abs(machine["tool_force"]) < 1e-3).all()
    assert (machine["tool_force"] >= 0.0).all()


def test_above_the_panel_nothing_is_cut(drill):
    machine = drill().feed(0.05, 1e-4, 0.0499)
    assert np.abs(machine["tool_force"]).max() < 1e-15
    assert machine["tip_height"][0] == pytest.approx(1e-4, abs=1e-12)


def test_a_hole_is_not_cut_again_but_deeper(drill):
    machine = drill().feed(0.0, -0.005, FEED)
    machine.feed(-0.005, -0.001, 0.01).wait(LAGS)
    machine.feed(-0.001, -0.005, FEED)
    assert np.abs(machine["tool_force"]).max() < 1e-3
    machine.feed(-0.005, -0.005 - LAGS * FEED, FEED)
    assert machine["tool_force"][0] == pytest.approx(150.0, rel=1e-3)


def test_the_next_hole_is_cut_from_its_beginning(drill):
    machine = drill().feed(0.0, -0.005, FEED).feed(-0.005, 0.004, 0.02)
    machine.feed(0.004, 0.0, 0.02).feed(0.0, -DEEP, FEED)
    assert machine["tool_force"][0] > 140.0


def test_load_follows_feed_by_its_lag(drill):
    machine = drill().feed(0.0, -0.005, FEED)
    before = machine["tool_force"][0]
    after = machine.wait(0.02)["tool_force"][0]
    assert after / before == pytest.approx(math.exp(-1.0), rel=1e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_a_pose_that_is_no_number_has_no_load_and_leaves_none_behind(drill, bad):
    for index in (0, 2, 4):
        machine = drill().feed(0.0, -DEEP, FEED)
        pose = HOLE.pose(PROCESS, -DEEP)
        pose[index] = bad
        machine.tick(30, pose=pose)
        assert np.abs(machine["tool_force"]).max() < 1e-3
        assert machine["tip_height"][0] == 1.0


def test_a_drill_that_lies_does_not_cut(drill):
    machine = drill()
    lying = Rotation.from_euler("x", 1.2)
    hole = Drill(np.concatenate((HOLE.hole[:3], lying.as_euler("xyz"))), 0.01)
    for k in range(40):
        machine.at(-k * FEED * PERIOD, hole)
    assert np.array_equal(machine["tool_force"], (0.0, 0.0))
