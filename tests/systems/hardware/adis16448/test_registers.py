import math
import random

import pytest
from pydrake.math import RollPitchYaw

from parapod.systems.hardware.adis16448.registers import (
    BURST_WORDS,
    FAILURES,
    MEASURES,
    SCALES,
    Register,
    crc16,
    decode_burst,
    failures,
    mounted,
    mounting_axes,
    sample_rate,
    signed,
    temperature,
    temperature_word,
)
from parapod.systems.sensors.imu import ImuParams, sample_period

# Example of Analog Devices' crc16adis.m for the ADIS16448: 11 words, and what their CRC is.
WORDS = (0x000F, 0xFFF8, 0x000A, 0xFE41, 0xFFCC, 0x0456, 0x0227, 0xFDA3, 0xF412, 0xC13C, 0xFF6C)
CRC = 0x9AF4


def test_crc_is_that_of_the_makers_example():
    assert crc16(WORDS) == CRC


def test_makers_example_is_a_sensor_that_lies_on_its_base():
    measured = decode_burst((0, *WORDS, CRC))
    assert measured["gyro"] == pytest.approx([math.radians(0.04 * n) for n in (15, -8, 10)])
    assert measured["accel"] == pytest.approx([9.80665 / 1200 * n for n in (-447, -52, 1110)])
    assert measured["mag"] == pytest.approx([1e-7 / 7 * n for n in (551, -605, -3054)])
    assert measured["temperature"] == pytest.approx([31 - 148 * 0.07386])
    assert 0.95 * 9.80665 < math.hypot(*measured["accel"]) < 1.05 * 9.80665


def test_every_damaged_bit_changes_the_crc():
    for index in range(len(WORDS)):
        for bit in range(16):
            damaged = list(WORDS)
            damaged[index] ^= 1 << bit
            assert crc16(damaged) != CRC


def test_odd_numbers_of_damaged_bits_change_the_crc():
    generator = random.Random(1)
    for number in (3, 5, 7):
        for _ in range(500):
            damaged = list(WORDS)
            for position in generator.sample(range(16 * len(WORDS)), number):
                damaged[position // 16] ^= 1 << position % 16
            assert crc16(damaged) != CRC


def test_scales_are_those_of_simulation():
    params = ImuParams()
    for name, scale in SCALES.items():
        assert scale.resolution == pytest.approx(getattr(params, f"{name}_resolution"), rel=1e-12)
        assert scale.limit == pytest.approx(getattr(params, f"{name}_range"), rel=1e-12)


# Data sheet: 1000 deg/s is 25000, 18 g is 21600, 1.9 gauss is 13300.
@pytest.mark.parametrize(("name", "most"), [("gyro", 25000), ("accel", 21600), ("mag", 13300)])
def test_counts_are_limited_to_the_range(name, most):
    scale = SCALES[name]
    assert scale.counts(2.0 * scale.limit) == scale.counts(math.inf) == most
    assert scale.counts(-2.0 * scale.limit) == scale.counts(-math.inf) == -most
    assert scale.counts(math.nan) == 0
    assert scale.counts(2.6 * scale.resolution) == 3


@pytest.mark.parametrize(
    ("word", "bits", "value"),
    [(0x7FFF, 16, 32767), (0x8000, 16, -32768), (0xFFFF, 16, -1), (0xF800, 12, -2048)],
)
def test_words_are_twos_complement(word, bits, value):
    assert signed(word, bits) == value


# Data sheet, "Temperature": 85, 31 and -40 degC.
@pytest.mark.parametrize(("value", "word"), [(85.0, 0x2DB), (31.0, 0x000), (-40.0, 0xC3F)])
def test_temperature_has_twelve_bits(value, word):
    assert temperature_word(value) == word
    assert temperature(signed(word, 12)) == pytest.approx(value, abs=0.07386 / 2)


def test_burst_has_the_registers_of_the_data_sheet():
    outputs = range(Register.XGYRO_OUT, Register.TEMP_OUT + 2, 2)
    assert len(outputs) + 2 == BURST_WORDS
    assert [Register(address) for address in outputs]
    measured = decode_burst((0, *WORDS, CRC))
    assert {name: len(values) for name, values in measured.items()} == MEASURES


def test_vectors_are_turned_into_the_frame_of_the_mounting():
    measured = decode_burst((0, *WORDS, CRC))
    angles = (0.3, -0.7, 2.0)
    turned = mounted(measured, mounting_axes(angles))
    rotation = RollPitchYaw(*angles).ToRotationMatrix()
    for name in SCALES:
        assert turned[name] == pytest.approx(rotation @ measured[name], rel=1e-12)
    assert turned["temperature"] == measured["temperature"]


def test_sensor_upside_down_is_turned():
    measured = decode_burst((0, *WORDS, CRC))
    x, y, z = measured["accel"]
    turned = mounted(measured, mounting_axes((math.pi, 0.0, 0.0)))
    assert turned["accel"] == pytest.approx((x, -y, -z))


def test_sensor_without_mounting_is_not_touched():
    measured = decode_burst((0, *WORDS, CRC))
    assert mounted(measured, mounting_axes((0.0, 0.0, 0.0))) is measured


@pytest.mark.parametrize("angles", [(0.0, 0.0), (0.0, 0.0, math.nan)])
def test_senseless_mounting_is_refused(angles):
    with pytest.raises(ValueError, match="mounting must be three finite angles"):
        mounting_axes(angles)


def test_each_failure_is_named():
    for bit, text in FAILURES.items():
        assert failures(1 << bit) == (text,)
    assert len(failures(0xFFFF)) == len(FAILURES)


def test_flags_that_are_no_failures_are_not():
    # A sensor out of its range, new values of the magnetometer, and two alarms.
    assert failures(1 << 4 | 1 << 7 | 1 << 8 | 1 << 9) == ()


def test_sample_rate_is_that_of_simulation():
    assert sample_rate(3) == pytest.approx(102.4)
    for decimation in range(13):
        assert sample_rate(decimation) * sample_period(decimation) == pytest.approx(1.0)


@pytest.mark.parametrize("decimation", [-1, 13])
def test_decimation_that_the_sensor_has_not_is_refused(decimation):
    with pytest.raises(ValueError, match="decimation must be from 0 to 12"):
        sample_rate(decimation)
