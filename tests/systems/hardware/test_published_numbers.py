"""Numbers that a driver shares with its emulator, so that both together would hide a wrong one."""

import pytest

from parapod.systems.hardware import canopen
from parapod.systems.hardware.adis16448 import registers

# CiA 301 (2011), 7.2.8 NMT services and 7.3.3 generic pre-defined connection set.
CANOPEN = {
    "SYNC_ID": 0x080,
    "NMT_ID": 0x000,
    "HEARTBEAT_BASE": 0x700,
    "NMT_START": 1,
    "NMT_PRE_OPERATIONAL": 128,
    "ON_SYNC": 1,
    "ON_ARRIVAL": 255,
    "NOT_VALID": 0x80000000,
}
# ADIS16448 data sheet: table 1 "Specifications", and the register that says 16448.
ADIS16448 = {"START_UP_TIME": 0.205, "PRODUCT_ID": 16448, "BURST_WORDS": 13}


@pytest.mark.parametrize(
    ("module", "published"), [(canopen, CANOPEN), (registers, ADIS16448)], ids=["CiA 301", "ADIS"]
)
def test_shared_numbers_are_those_of_the_standard_or_the_maker(module, published):
    assert {name: getattr(module, name) for name in published} == published
