import math
import random

import pytest

from parapod.systems.hardware.sabertooth.protocol import (
    ADDRESSES,
    STOPPED,
    Command,
    Direction,
    Packet,
    PacketParser,
    Power,
    motor_of,
    motor_packet,
    packet,
    power,
    timeout_packet,
    voltage,
)

SUPPLY = 12.0
STEP = SUPPLY / 127.0


# --- packets


def test_example_of_the_manual():
    # Its checksum example: address 130, command 0, data 64.
    assert packet(130, 0, 64) == bytes((130, 0, 64, 66))


def test_only_addresses_have_the_high_bit():
    for address in ADDRESSES:
        for command in Command:
            for data in (0, 1, 64, 126, 127):
                first, *rest = packet(address, command, data)
                assert first == address
                assert all(byte < 128 for byte in rest)


@pytest.mark.parametrize(("command", "name"), [(16, "ramping"), (17, "deadband")])
def test_commands_that_outlast_the_power_are_refused(command, name):
    with pytest.raises(ValueError, match=rf"{command} \({name}\) is not sent.*EEPROM"):
        packet(128, command, 0)


@pytest.mark.parametrize("command", [-1, 2, 3, 6, 13, 18, 128])
def test_other_commands_are_refused(command):
    with pytest.raises(ValueError, match="not a valid Command"):
        packet(128, command, 0)


@pytest.mark.parametrize(
    ("address", "data", "words"),
    [
        (127, 0, r"128\.\.135, not 127"),
        (136, 0, r"128\.\.135, not 136"),
        (170, 0, r"128\.\.135, not 170"),
        (128, -1, r"0\.\.127, not -1"),
        (128, 128, r"0\.\.127, not 128"),
    ],
)
def test_what_does_not_fit_a_packet_is_refused(address, data, words):
    with pytest.raises(ValueError, match=words):
        packet(address, Command.MOTOR_1_FORWARDS, data)


@pytest.mark.parametrize(
    ("motor", "direction", "command"),
    [
        (1, Direction.FORWARDS, 0),
        (1, Direction.BACKWARDS, 1),
        (2, Direction.FORWARDS, 4),
        (2, Direction.BACKWARDS, 5),
    ],
)
def test_motors_have_a_command_for_each_direction(motor, direction, command):
    assert motor_packet(129, motor, Power(direction, 100)) == packet(129, command, 100)
    assert motor_of(command) == (motor, direction)


def test_other_commands_are_about_no_motor():
    assert motor_of(Command.SERIAL_TIMEOUT) is None
    with pytest.raises(ValueError, match="1 and 2, not 3"):
        motor_packet(128, 3, STOPPED)


@pytest.mark.parametrize(("seconds", "units"), [(0.1, 1), (0.2, 2), (0.3, 3), (12.7, 127)])
def test_timeouts_are_in_tenths_of_a_second(seconds, units):
    assert timeout_packet(128, seconds) == packet(128, 14, units)


@pytest.mark.parametrize("seconds", [0.0, 0.05, 0.15, 0.201, -0.1, 12.8, math.nan, math.inf])
def test_other_timeouts_are_refused(seconds):
    with pytest.raises(ValueError, match=r"multiple of 0\.1 s"):
        timeout_packet(128, seconds)


# --- voltages


def test_voltages_come_back_within_half_a_step():
    for k in range(-1200, 1201):
        wanted = k * 0.01
        assert voltage(power(wanted, SUPPLY), SUPPLY) == pytest.approx(wanted, abs=0.501 * STEP)


def test_direction_is_the_sign():
    assert power(6.0, SUPPLY) == (Direction.FORWARDS, 64)
    assert power(-6.0, SUPPLY) == (Direction.BACKWARDS, 64)
    assert power(0.0, SUPPLY) == power(-0.0, SUPPLY) == power(-0.4 * STEP, SUPPLY) == STOPPED


def test_more_voltage_is_never_less_power():
    data = [power(k * 0.01, SUPPLY).data for k in range(1300)]
    assert data == sorted(data)
    assert data[0] == 0
    assert set(data) == set(range(128))


def test_power_ends_at_the_supply():
    assert power(12.0, SUPPLY) == power(13.0, SUPPLY) == power(1e308, SUPPLY)
    assert power(-1e308, SUPPLY) == (Direction.BACKWARDS, 127)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_no_power(bad):
    assert power(bad, SUPPLY) == STOPPED


# --- the receiving side


def test_packets_may_come_in_pieces():
    parser = PacketParser()
    data = packet(128, 0, 5) + packet(135, 14, 2)
    found = [packet for byte in data for packet in parser.feed(bytes((byte,)))]
    assert found == [Packet(128, 0, 5), Packet(135, 14, 2)]


def test_wrong_checksum_is_no_packet():
    parser = PacketParser()
    assert parser.feed(bytes((130, 0, 64, 67))) == []
    assert parser.rejected == 1
    assert parser.feed(bytes((130, 0, 64, 66))) == [Packet(130, 0, 64)]


@pytest.mark.parametrize("position", range(4))
def test_any_damaged_bit_is_noticed(position):
    for bit in range(8):
        data = bytearray(packet(129, 5, 99))
        data[position] ^= 1 << bit
        assert PacketParser().feed(bytes(data)) == []


def test_packet_that_is_cut_short_costs_no_other():
    for length in range(1, 4):
        data = packet(128, 0, 1)[:length] + packet(129, 4, 2)
        assert PacketParser().feed(data) == [Packet(129, 4, 2)]


def test_garbage_before_a_packet_costs_no_packet():
    rng = random.Random(1)
    for _ in range(3000):
        garbage = rng.randbytes(rng.randrange(40))
        expected = Packet(rng.choice(ADDRESSES), rng.choice(list(Command)), rng.randrange(128))
        assert PacketParser().feed(garbage + packet(*expected))[-1] == expected


def test_bytes_of_other_devices_are_ignored():
    parser = PacketParser()
    assert parser.feed(bytes((136, 0, 64, 72, 170, 0, 64, 106, 1, 2, 3, 4))) == []
    assert parser.rejected == 0
