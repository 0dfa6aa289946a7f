import math
import time

import pytest

from parapod.systems.hardware.canopen import Entry, mapping_of
from parapod.systems.hardware.cia402 import objects
from parapod.systems.hardware.cia402.device import unwrapped
from parapod.systems.hardware.cia402.emulated_drive import EmulatedMotor
from parapod.systems.hardware.cia402.set_up import process_data, set_up_of
from parapod.systems.hardware.cia402.settings import GearSettings
from parapod.systems.hardware.cia402.states import DriveState
from parapod.systems.hardware.device import DeviceError, DeviceFault

RPM = 2.0 * math.pi / 60.0
RESOLUTION = RPM / 26.0  # of a velocity at the wheel: whole rpm at the motor
COUNT = 2.0 * math.pi / 52_000.0


def wheels(velocity, brake=0.0):
    return {"velocity_command": velocity, "brake": (brake,)}


@pytest.fixture
def rig(make_rig, drive):
    with make_rig({"drive": drive}) as rig:
        yield rig


def fault_of(call, *arguments):
    with pytest.raises(DeviceError) as caught:
        call(*arguments)
    return caught.value


# --- the life of a device


def test_drives_have_power_while_they_are_active(rig):
    rig.drives.configure()
    rig.drives.write(wheels((1.0, 2.0, 3.0, 4.0)))
    rig.drives.read()
    assert set(rig.nodes.states) == {DriveState.SWITCH_ON_DISABLED}
    rig.drives.activate()
    assert set(rig.nodes.states) == {DriveState.OPERATION_ENABLED}
    rig.drives.deactivate()
    rig.wait_for(DriveState.SWITCH_ON_DISABLED)


def test_pause_before_activate_is_harmless(make_rig):
    with make_rig({"heartbeat_timeout": 0.1}) as rig:
        rig.drives.configure()
        time.sleep(0.25)
        rig.drives.read()
        rig.drives.activate()


# --- signals


def test_velocities_arrive_in_whole_units(rig):
    rig.activate()
    wanted = (1.0, -2.0, 0.1234, 10.0)
    rig.drives.write(wheels(wanted))
    unit = RESOLUTION / rig.nodes.nodes[0]._per_rpm
    expected = pytest.approx([round(v / unit) * unit for v in wanted], abs=1e-12)
    rig.wait(lambda: rig.command == expected)
    assert rig.command == pytest.approx(wanted, abs=0.5 * RESOLUTION * (1.0 + 1e-9))
    assert not rig.is_braked


def test_one_turn_of_the_wheel_is_52_000_counts():
    assert GearSettings(gear=26.0).position(52_000) == pytest.approx(2.0 * math.pi, rel=1e-15)


def test_position_goes_on_when_the_counter_overflows(make_rig):
    with make_rig(motor=EmulatedMotor(position_offset=(1 << 31) - 10)) as rig:
        rig.drives.configure()
        start = rig.drives.read()["position"][0]
        for turns in (0.5, 1.0, 0.2):
            rig.harness.set("wheels.position", (turns,) * 4)
            expected = pytest.approx(start + turns, abs=COUNT)
            rig.wait(lambda e=expected: rig.drives.read()["position"][0] == e)


@pytest.mark.parametrize(
    ("counts", "previous", "expected"),
    [
        (7, None, 7),
        (-(1 << 31), (1 << 31) - 1, 1 << 31),
        ((1 << 31) - 1, -(1 << 31), -(1 << 31) - 1),
        (3, (1 << 32) + 1, (1 << 32) + 3),
    ],
)
def test_unwrapped(counts, previous, expected):
    assert unwrapped(counts, previous) == expected


def test_velocity_is_limited(rig):
    rig.activate()
    rig.drives.write(wheels((1e9, -1e9, 0.0, 0.0)))
    limit = 8000.0 * RESOLUTION
    # Whole counts per second are at most 0.03 rpm too many.
    rig.wait(lambda: rig.command == pytest.approx((limit, -limit, 0.0, 0.0), rel=4e-6))


def test_velocity_follows_a_ramp(make_rig):
    with make_rig({"acceleration": 2.0}) as rig:
        rig.activate()
        start = time.monotonic()
        rig.drives.write(wheels((1.0,) * 4))
        rig.wait(lambda: rig.command[0] > 0.9)
        assert time.monotonic() - start > 0.4


def test_neutral_stops_and_holds(rig):
    rig.activate()
    rig.drives.write(wheels((1.0,) * 4))
    rig.wait(lambda: rig.command[0] > 0.9)
    rig.drives.neutral()
    rig.wait(lambda: rig.command == (0.0,) * 4)
    assert set(rig.nodes.states) == {DriveState.OPERATION_ENABLED}


def test_brake_is_the_quick_stop_and_needs_no_homing(rig):
    rig.activate()
    rig.harness.set("wheels.position", (5.0,) * 4)
    rig.wait(lambda: rig.drives.read()["position"] == pytest.approx((5.0,) * 4, abs=COUNT))
    before = rig.drives.read()["position"]
    rig.drives.write(wheels((1.0,) * 4, brake=1.0))
    rig.wait(lambda: set(rig.nodes.states) == {DriveState.QUICK_STOP_ACTIVE})
    assert rig.is_braked
    rig.drives.neutral()
    rig.drives.read()
    assert set(rig.nodes.states) == {DriveState.QUICK_STOP_ACTIVE}
    rig.drives.write(wheels((1.0,) * 4))
    rig.wait(lambda: rig.command == pytest.approx((1.0,) * 4, abs=RESOLUTION))
    assert not rig.is_braked
    assert rig.drives.read()["position"] == before


# --- refusals


def test_missing_node_is_named_with_those_that_answer(make_rig):
    with make_rig({"node_ids": [1, 2, 9, 4], "sdo_timeout": 0.2}) as rig:
        error = fault_of(rig.drives.configure)
        assert error.fault is DeviceFault.SILENT
        assert "node 9 does not answer; nodes that do: 1, 2, 3, 4" in str(error)
        assert rig.nodes.channel in str(error)


def test_wrong_channel_has_no_nodes(make_rig):
    with make_rig({"channel": "elsewhere", "sdo_timeout": 0.1}) as rig:
        error = fault_of(rig.drives.configure)
        assert error.fault is DeviceFault.SILENT
        assert "virtual elsewhere: node 1 does not answer; nodes that do: none" in str(error)


@pytest.mark.parametrize(
    ("motor", "words"),
    [
        (EmulatedMotor(vendor=0x2E), "vendor 0x2E"),
        (EmulatedMotor(hardware=0x6320), "hardware 0x6320"),
    ],
)
def test_other_devices_are_refused(make_rig, motor, words):
    with make_rig(motor=motor) as rig:
        error = fault_of(rig.drives.configure)
        assert error.fault is DeviceFault.CORRUPT
        assert words in str(error)
        assert "node 1" in str(error)
        assert set(rig.nodes.states) == {DriveState.SWITCH_ON_DISABLED}


def test_other_encoder_is_refused(make_rig):
    with make_rig(motor=EmulatedMotor(pulses=1000)) as rig:
        assert "4000 counts per turn, not 2000" in str(fault_of(rig.drives.configure))


# --- faults


def test_configure_resets_a_latched_fault(rig):
    rig.nodes.trip(2, 0x2310)
    rig.drives.configure()
    rig.drives.activate()
    assert set(rig.nodes.states) == {DriveState.OPERATION_ENABLED}


def test_fault_is_told_with_its_code_and_words(rig):
    rig.activate()
    rig.nodes.trip(3, 0x2310)
    error = fault_of(rig.drives.read)
    assert error.fault is DeviceFault.FAILED
    assert "node 3 is in fault: EMCY 0x2310 (overcurrent)" in str(error)
    # Commands do not bring it back, and the other wheels go on.
    rig.drives.write(wheels((1.0,) * 4))
    rig.wait_alone(lambda: rig.command[0] > 0.9)
    assert rig.command[2] == 0.0


def test_activate_does_not_reset_a_fault_of_the_drive(rig):
    rig.drives.configure()
    rig.nodes.trip(1, 0x3210)
    assert "EMCY 0x3210 (overvoltage)" in str(fault_of(rig.drives.activate))
    assert rig.is_braked


def test_silent_caller_lets_the_wheels_stop(make_rig, judge):
    params = {"heartbeat_timeout": 0.1, "quick_stop_deceleration": 100.0}
    with make_rig(params) as rig:
        rig.activate()
        rig.drives.write(wheels((2.0,) * 4))
        rig.wait(lambda: rig.command == pytest.approx((2.0,) * 4, abs=RESOLUTION))
        with judge() as judged:
            rig.wait_alone(lambda: rig.is_braked)
        judged.check(0.2)
        assert rig.command == (0.0,) * 4
        rig.wait_for(DriveState.FAULT)
        error = fault_of(rig.drives.read)
        assert error.fault is DeviceFault.FAILED
        assert "node 1 is in fault: EMCY 0x8130" in str(error)
        rig.drives.write(wheels((2.0,) * 4))
        assert rig.is_braked
        # Asked to, the drives recover from what was not their fault, and know where they are.
        rig.drives.activate()
        assert rig.drives.read()["position"] == pytest.approx((0.0,) * 4, abs=COUNT)
        rig.drives.write(wheels((1.0,) * 4))
        rig.wait(lambda: rig.command == pytest.approx((1.0,) * 4, abs=RESOLUTION))


def test_wheels_are_guarded_as_soon_as_they_have_power(make_rig, judge):
    with make_rig({"heartbeat_timeout": 0.1}) as rig:
        rig.activate()
        with judge() as judged:
            rig.wait_alone(lambda: rig.is_braked)
        judged.check(0.2)


def test_unplugged_nodes_stop_the_wheels(make_rig):
    with make_rig({"heartbeat_timeout": 0.1, "timeout": 0.05}) as rig:
        rig.activate()
        rig.misbehaviour.begin("unplugged", time.monotonic())

        def read():
            assert fault_of(rig.drives.read).fault is DeviceFault.SILENT

        rig.wait(lambda: rig.is_braked, read)


def test_node_that_restarts_is_noticed(rig):
    rig.activate()
    rig.drives._bus.manage(2, 0x81)
    error = fault_of(lambda: [rig.drives.read() for _ in range(100)])
    assert "node 2" in str(error)


def test_power_that_is_lost_is_noticed(rig):
    rig.activate()
    rig.drives._bus.set(4, objects.CONTROLWORD, 0x00)
    error = fault_of(rig.drives.read)
    assert error.fault is DeviceFault.FAILED
    assert "node 4 has lost its power, it is in switch on disabled" in str(error)


# --- what goes over the bus


def test_settings_name_each_entry_and_make_pdos_valid_last():
    written = [
        *set_up_of(GearSettings(gear=26.0)),
        *mapping_of(process_data(GearSettings(gear=26.0), 3), 3),
    ]
    values = dict(written)
    assert values[objects.MODE] == 3
    assert values[objects.MAX_VELOCITY] == 8000
    assert values[objects.ACCELERATION] == round(20.0 * 26.0 / RPM)
    assert values[Entry(0x1400, 1, "<I")] == 0x203
    assert values[Entry(0x1800, 1, "<I")] == 0x183
    assert values[Entry(0x1801, 1, "<I")] == 0x283
    assert values[Entry(0x1600, 1, "<I")] == 0x60400010
    assert values[Entry(0x1600, 2, "<I")] == 0x60FF0020
    assert values[Entry(0x1A00, 2, "<I")] == 0x60640020
    assert values[Entry(0x1A01, 1, "<I")] == 0x606C0020
    first = written.index((Entry(0x1800, 1, "<I"), 0x183 | 1 << 31))
    assert first < written.index((Entry(0x1800, 1, "<I"), 0x183))


def test_command_frame_is_controlword_and_rpm():
    assert objects.PROFILE_VELOCITY.command.pack(0x0F, -1500) == bytes.fromhex("0F0024FAFFFF")
