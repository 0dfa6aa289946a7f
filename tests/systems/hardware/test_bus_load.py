"""How much of a bus the drives take."""

import pytest

from parapod.systems.hardware.bus_load import bus_load, frame_bits
from parapod.systems.hardware.epos2_setup import Epos2Params

LEGS = Epos2Params(node_ids=tuple(range(1, 13)), measures_current=True)


@pytest.mark.parametrize(
    ("size", "bits"),
    # The worst case of a standard frame of 8 bytes is 135 bits: 111 + 24 stuff bits; with the
    # pause of 3 bits between frames in the 111. An empty one: 47 + 8.
    [(0, 55), (1, 65), (6, 115), (8, 135)],
)
def test_frames_take_as_many_bits_as_in_the_worst_case(size, bits):
    assert frame_bits(size) == bits


def test_twelve_legs_take_less_than_half_of_a_megabit():
    # SYNC, 12 times two answers and a command of 6 bytes each, half a heartbeat in 10 ms.
    expected = (55 + 12 * 3 * 115 + 0.5 * 65) / 10_000
    assert bus_load(LEGS, 0.01) == pytest.approx(expected, rel=1e-12)
    assert bus_load(LEGS, 0.01) < 0.5


def test_current_costs_a_little():
    without = Epos2Params(node_ids=LEGS.node_ids)
    assert bus_load(LEGS, 0.01) - bus_load(without, 0.01) == pytest.approx(12 * 20 / 10_000)


def test_a_slower_loop_has_its_heartbeat_once_a_cycle():
    assert bus_load(Epos2Params(), 0.04) == pytest.approx((55 + 4 * (230 + 95) + 65) / 40_000)
