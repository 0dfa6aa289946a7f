"""Workspaces on grids: areas and volumes that are known, and errors that go with the grid."""

from pathlib import Path

import numpy as np
import pytest

from parapod.systems.core.errors import ScenarioError
from parapod.systems.mechanism.mechanism import Mechanism
from parapod.systems.mechanism.reach import reach
from tests.systems.mechanism.conftest import MECHANISMS

# A two-bar whose pins are free to turn: the ring between its difference and its sum.
TWO_BAR = """<robot name="two_bar">
  <link name="base"/><link name="upper"/><link name="lower"/><link name="hand"/>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/>
    <axis xyz="0 0 1"/></joint>
  <joint name="elbow" type="{kind}"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.3 0 0" rpy="0 0 0.9"/><axis xyz="0 0 1"/>
    <limit lower="-0.8" upper="2.2" effort="1" velocity="1"/></joint>
  <joint name="wrist" type="fixed"><parent link="lower"/><child link="hand"/>
    <origin xyz="0.2 0 0"/></joint>
</robot>"""
MOTORS = ("shoulder", "elbow")


def two_bar(folder: Path, kind: str = "continuous") -> Mechanism:
    path = folder / "two_bar.urdf"
    path.write_text(TWO_BAR.replace("{kind}", kind))
    return Mechanism.load(path, motors=MOTORS)


def ring(mechanism: Mechanism, count: int):
    return reach(mechanism, "hand", {0: (-0.6, 0.6, count), 1: (-0.6, 0.6, count)})


def test_the_area_of_a_two_bar_is_that_of_its_ring(tmp_path):
    area = np.pi * (0.5**2 - 0.1**2)
    mechanism, errors = two_bar(tmp_path), []
    for count in (30, 60, 120):
        found = ring(mechanism, count)
        assert abs(found.volume - area) < found.error
        assert not found.cut_off
        errors.append(found.error)
    # Twice as fine: half the error.
    assert errors[1] / errors[0] == pytest.approx(0.5, abs=0.1)
    assert errors[2] / errors[1] == pytest.approx(0.5, abs=0.1)


def test_limits_bound_the_ring(tmp_path):
    mechanism = two_bar(tmp_path, "revolute")

    def radius(elbow: float) -> float:
        turn = 0.9 + elbow
        return float(np.hypot(0.3 + 0.2 * np.cos(turn), 0.2 * np.sin(turn)))

    area = np.pi * (radius(-0.8) ** 2 - radius(2.2) ** 2)
    found = ring(mechanism, 120)
    assert abs(found.volume - area) < found.error
    assert mechanism.is_within_limits(found.positions).all()


def test_poses_of_cells_are_closed_and_in_their_cells():
    mechanism = Mechanism.load(MECHANISMS / "delta" / "delta.xml")
    ranges = {0: (-0.3, 0.3, 12), 1: (-0.3, 0.3, 12), 2: (-0.6, -0.15, 9)}
    found = reach(mechanism, "platform", ranges)
    assert found.is_reached.sum() == len(found.positions) > 200
    cells = np.argwhere(found.is_reached)
    for cell, q in list(zip(cells, found.positions, strict=True))[::17]:
        assert np.abs(mechanism.residual(q)).max() < 1e-9
        middle = [axis[i] for axis, i in zip(found.axes, cell, strict=True)]
        place = mechanism.pose("platform", q).translation()
        np.testing.assert_allclose(place, middle, rtol=0.0, atol=1e-9)


def test_the_delta_reaches_alike_in_three_directions():
    mechanism = Mechanism.load(MECHANISMS / "delta" / "delta.xml")
    ranges = {0: (-0.4, 0.4, 40), 1: (-0.4, 0.4, 40)}
    height = mechanism.pose("platform", mechanism.home).translation()[2]
    found = reach(mechanism, "platform", ranges, fixed={2: height})
    x, y = np.meshgrid(*found.axes, indexing="ij")
    angle = np.arctan2(y, x)[found.is_reached]
    thirds = [np.sum(np.abs(np.remainder(angle - way + np.pi, 2 * np.pi) - np.pi) < np.pi / 3)
              for way in np.radians((0.0, 120.0, 240.0))]  # fmt: skip
    assert np.ptp(thirds) < 0.05 * np.mean(thirds)
    assert found.volume > 0.02


def test_poses_near_singular_positions_can_be_left_out(tmp_path):
    mechanism = Mechanism.load(MECHANISMS / "hexapod" / "hexapod.urdf")
    ranges = {2: (0.4, 0.55, 6), 5: (-1.2, 1.2, 24)}
    fixed = {0: 0.0, 1: 0.0, 3: 0.0, 4: 0.0}
    whole = reach(mechanism, "platform", ranges, fixed)
    bold = reach(mechanism, "platform", ranges, fixed, least_held=0.08)
    assert 0 < bold.is_reached.sum() < whole.is_reached.sum()


def test_grids_that_do_not_do_are_refused_in_a_line(tmp_path):
    mechanism = two_bar(tmp_path)
    with pytest.raises(ScenarioError, match="2 cells and more along each part"):
        reach(mechanism, "hand", {0: (-0.6, 0.6, 1)})
    with pytest.raises(ScenarioError, match="does not hold the first pose"):
        reach(mechanism, "hand", {0: (-0.6, -0.5, 5), 1: (-0.6, 0.6, 5)})
