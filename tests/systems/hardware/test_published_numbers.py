"""Numbers that a driver shares with its emulator, so that both together would hide a wrong one."""

import math

import pytest

from parapod.systems.hardware import canopen
from parapod.systems.hardware.adis16448 import registers
from parapod.systems.hardware.cia402 import objects
from parapod.systems.hardware.cia402.makers import EPOS2
from parapod.systems.sensors.imu import ImuParams

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


# CiA 301 (2011), 7.5.2.19 and 7.5.2.20; CiA 402-2.
OBJECTS = {
    "HEARTBEAT_CONSUMED": (0x1016, 1),
    "HEARTBEAT_PRODUCED": (0x1017, 0),
    "ERROR_CODE": (0x1003, 1),
    "VENDOR": (0x1018, 1),
    "PRODUCT": (0x1018, 2),
    "ABORT_CONNECTION": (0x6007, 0),
    "CONTROLWORD": (0x6040, 0),
    "STATUSWORD": (0x6041, 0),
    "MODE": (0x6060, 0),
    "POSITION": (0x6064, 0),
    "VELOCITY": (0x606C, 0),
    "MAX_VELOCITY": (0x607F, 0),
    "ACCELERATION": (0x6083, 0),
    "DECELERATION": (0x6084, 0),
    "QUICK_STOP_DECELERATION": (0x6085, 0),
    "PROFILE_TYPE": (0x6086, 0),
    "TARGET_VELOCITY": (0x60FF, 0),
}


@pytest.mark.parametrize("name", OBJECTS)
def test_objects_are_where_the_dictionaries_have_them(name):
    entry = getattr(objects, name, None) or getattr(canopen, name)
    assert (entry.index, entry.subindex) == OBJECTS[name]


# Error codes of the EPOS2 Firmware Specification, chapter "Error Handling", by their groups.
EPOS2_ERRORS = {
    0x1000: (0x0,),
    0x2310: (0x0,),
    0x3210: (0x0, 0x10),
    0x4210: (0x0,),
    0x5113: (0x0, 0x1),
    0x6100: (0x0, 0x220),
    0x7320: (0x0,),
    0x8110: (0x0, 0x1, 0x10, 0x20, 0x40, 0xED, 0xEE, 0xEF),
    0x8210: (0x0, 0x401),
    0xFF01: (0x0, 0x1, 0x5, 0x6, 0x8, 0x9, 0xA),
}


def test_the_errors_of_an_epos2_are_those_of_its_firmware():
    published = {first + further for first, rest in EPOS2_ERRORS.items() for further in rest}
    assert set(EPOS2.errors) < published < set(EPOS2.errors) | set(objects.ERRORS)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x2310, "overcurrent"),
        (0x8130, "heartbeat"),
        (0x8611, "following error"),
        (0xFF06, "negative limit switch"),
        (0xFF09, "software position limit"),
    ],
)
def test_an_error_is_told_with_its_code_and_in_words(code, words):
    assert EPOS2.described(code).startswith(f"EMCY 0x{code:04X} (")
    assert words in EPOS2.described(code)


@pytest.mark.parametrize(
    ("kind", "unit", "noise", "instability", "resolution", "largest"),
    [
        ("gyro", math.radians(1.0), 0.0135, 14.5 / 3600.0, 0.04, 1000.0),
        ("accel", 9.80665e-3, 0.23, 0.25, 1000.0 / 1200.0, 18e3),
        ("mag", 1e-7, 0.06, None, 1.0 / 7.0, 1.9e3),
    ],
)
def test_the_simulated_sensor_has_the_numbers_of_the_data_sheet(
    kind, unit, noise, instability, resolution, largest
):
    """In deg/s, mg and mgauss; densities for the square root of a hertz."""
    imu = ImuParams()
    assert getattr(imu, f"{kind}_noise_density") == pytest.approx(noise * unit)
    assert getattr(imu, f"{kind}_resolution") == pytest.approx(resolution * unit)
    assert getattr(imu, f"{kind}_range") == pytest.approx(largest * unit)
    if instability is not None:
        assert getattr(imu, f"{kind}_bias_instability") == pytest.approx(instability * unit)
