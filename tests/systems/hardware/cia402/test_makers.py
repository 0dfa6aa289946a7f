"""Drives of every maker: identity, units, modes, and behaviour that all of them share."""

import itertools
import math

import pytest

from parapod.systems.core.schema import fields_of
from parapod.systems.hardware.canopen import PDO_COUNT, Entry, mapping_of
from parapod.systems.hardware.cia402 import objects
from parapod.systems.hardware.cia402.emulated_drive import RATED, EmulatedMotor
from parapod.systems.hardware.cia402.makers import EPOS2, MAKERS, maker_of
from parapod.systems.hardware.cia402.positions import Cia402Positions
from parapod.systems.hardware.cia402.set_up import mode_of, process_data, set_up_of
from parapod.systems.hardware.cia402.settings import (
    AxesSettings,
    Control,
    ForceSlideSettings,
    GearSettings,
    PositionScrewSettings,
    PositionTurnSettings,
    ScrewSettings,
    TorqueSettings,
)
from parapod.systems.hardware.cia402.states import DriveState
from parapod.systems.hardware.cia402.velocities import Cia402Velocities
from parapod.systems.hardware.device import DeviceError, DeviceFault

GEAR = 26.0
COUNT = 2.0 * math.pi / (2000.0 * GEAR)
PERIOD = 0.01
OTHERS = [name for name in MAKERS if name != "epos2"]
KINDS = (GearSettings, PositionTurnSettings, TorqueSettings)


class Clock:
    """Time that passes when a test says so [s]."""

    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now


def refused(call):
    with pytest.raises(DeviceError) as caught:
        call()
    return caught.value


# --- tables


def test_every_table_has_its_choice_of_a_scenario():
    assert fields_of(AxesSettings)["drive"][1].options == tuple(MAKERS)


@pytest.mark.parametrize("name", MAKERS)
def test_a_table_is_recognised_by_its_own_identity_and_no_other(name):
    maker = MAKERS[name]
    product = next(iter(maker.models), 0x6150) << 16
    assert maker_of(maker.vendor, product) is maker


@pytest.mark.parametrize(
    ("vendor", "hardware", "name"),
    [
        (0xFB, 0x6220, "epos2"),
        (0xFB, 0x6322, "epos2"),
        (0xFB, 0x6150, "epos4"),
        (0xFB, 0x6050, "epos4"),
        (0x26C, 0x0000, "nanotec"),
        (0x9A, 0x0003, "elmo"),
        (0x9A, 0x0002, None),
        (0x2E, 0x6220, None),
    ],
)
def test_identities_that_makers_have_published(vendor, hardware, name):
    assert maker_of(vendor, hardware << 16) is MAKERS.get(name)


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("kind", KINDS)
def test_process_data_fit_in_the_frames_that_a_node_has(name, kind):
    settings = kind(drive=name, node_ids=[5], stop_node=5)
    pdos = process_data(settings, 5)
    assert all(pdo.size <= 8 for pdo in pdos)
    assert all(sum(p.base & 0x80 == way for p in pdos) <= PDO_COUNT for way in (0, 0x80))
    assert len({pdo.base for pdo in pdos}) == len(pdos)
    carried = [entry for pdo in pdos if pdo.base & 0x80 for entry in pdo.entries]
    assert carried[:2] == [objects.STATUSWORD, objects.POSITION]
    assert {objects.VELOCITY, MAKERS[name].inputs.state} < set(carried)
    told = {entry.index for entry, _ in mapping_of(pdos, 5) if entry.subindex == 1}
    assert {*range(0x1400, 0x1404), *range(0x1800, 0x1804)} <= told  # also those that are not used


@pytest.mark.parametrize("name", OTHERS)
def test_modes_of_other_makers_are_the_cyclic_ones(name):
    numbers = [mode_of(kind(drive=name)).number for kind in KINDS]
    assert numbers == [3, 8, 10]
    assert mode_of(GearSettings(drive=name, mode=9)) is objects.CYCLIC_VELOCITY


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"mode": 9}, "mode of EPOS2 for a velocity must be 3, not 9"),
        ({"drive": "elmo", "mode": 8}, "for a velocity must be 3, 9, not 8"),
    ],
)
def test_a_mode_that_a_drive_does_not_have_is_refused_with_those_it_has(settings, words):
    with pytest.raises(ValueError, match=words):
        Cia402Velocities(GearSettings(**settings))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"mode": 8}, "mode of EPOS2 for a position must be -1, not 8"),
        ({"feedforward": 0.5}, "feedforward must be 0 with mode -1 of EPOS2"),
        ({"drive": "nanotec", "feedforward": 0.5}, "feedforward must be 0 with mode 8 of Nanotec"),
    ],
)
def test_positions_that_a_drive_does_not_take_so_are_refused(settings, words):
    with pytest.raises(ValueError, match=words):
        Cia402Positions(PositionTurnSettings(**settings))


def test_an_output_that_a_drive_does_not_have_is_refused():
    locks = {"lock_nodes": [1], "lock_outputs": [3], "lock_inputs": [1]}
    ends = {"position_min_mm": [0.0], "position_max_mm": [1.0]}
    with pytest.raises(ValueError, match=r"digital outputs of Nanotec are 1\.\.2, not 3"):
        Cia402Positions(PositionScrewSettings(drive="nanotec", **locks, **ends))


# --- units


def test_velocities_are_rpm_or_counts_per_second():
    for name, unit in (("epos2", 1.0), ("epos4", 1.0), ("nanotec", 1.0), ("elmo", 2000.0 / 60.0)):
        values = dict(set_up_of(GearSettings(drive=name, gear=GEAR, max_velocity_rpm=3000.0)))
        per_second = 20.0 * GEAR * 60.0 / (2.0 * math.pi)
        assert values[objects.ACCELERATION] == round(per_second * unit)
        if name != "nanotec":  # has no such limit
            assert values[objects.MAX_VELOCITY] == round(3000.0 * unit)
        if name in ("epos4", "elmo"):
            assert values[objects.MAX_MOTOR_VELOCITY] == 3000
        assert (objects.VELOCITY_UNIT in values) == (name in ("epos4", "nanotec"))


def test_the_largest_current_is_milliamperes_or_thousandths_of_the_rated_one():
    limit = {"epos2": 3000, "epos4": 3000, "nanotec": 3000, "elmo": 1500}
    for name, value in limit.items():
        settings = ForceSlideSettings(drive=name, current_limit_a=3.0, max_force_N=100.0)
        assert dict(set_up_of(settings, 2000.0))[MAKERS[name].current_limit] == value


def test_the_period_of_commands_is_told_to_cyclic_positions():
    settings = PositionTurnSettings(drive="epos4", command_period_ms=4)
    values = dict(set_up_of(settings))
    assert (values[objects.PERIOD], values[objects.PERIOD_EXPONENT]) == (4, -3)
    assert objects.PERIOD not in dict(set_up_of(PositionTurnSettings()))
    assert values[objects.TORQUE_OFFSET] == 0  # of another program


def test_a_torque_ends_at_once_and_not_on_a_ramp():
    for name in OTHERS:
        assert dict(set_up_of(TorqueSettings(drive=name)))[objects.DISABLE_OPTION] == 0
        assert objects.DISABLE_OPTION not in dict(set_up_of(GearSettings(drive=name)))


# --- identity


@pytest.mark.parametrize("name", MAKERS)
def test_a_node_of_another_profile_is_refused_with_its_type(make_rig, name):
    with make_rig({"drive": name}, motor=EmulatedMotor(profile=401)) as rig:
        error = refused(rig.drives.configure)
        assert error.fault is DeviceFault.CORRUPT
        assert "node 1 is not a CiA 402 drive: its device type (0x1000) is 0x00020191" in str(
            error
        )


@pytest.mark.parametrize(("name", "other"), itertools.permutations(MAKERS, 2))
def test_a_drive_of_another_maker_is_refused_with_both(make_rig, name, other):
    hardware = 0x6150 if other == "epos4" else None
    with make_rig(
        {"drive": name}, maker=MAKERS[other], motor=EmulatedMotor(hardware=hardware)
    ) as rig:
        error = refused(rig.drives.configure)
    assert error.fault is DeviceFault.CORRUPT
    for words in (MAKERS[other].name, f"not an {MAKERS[name].name} (", f"drive: {name}"):
        assert words in str(error)
    assert set(rig.nodes.states) == {DriveState.SWITCH_ON_DISABLED}


@pytest.mark.parametrize("name", OTHERS)
def test_a_motor_without_a_rated_current_takes_no_torques(make_rig, name):
    settings = {"drive": name, "node_ids": [1, 2], "signs": [1, 1]}
    with make_rig(settings, TorqueSettings, axes=2, node_ids=[1, 2]) as rig:
        entry = MAKERS[name].rated_current
        rig.nodes.nodes[0]._slave.node.set_data(entry.index, entry.subindex, entry.pack(0))
        assert "node 1 knows no rated current of its motor" in str(refused(rig.drives.configure))


# --- behaviour


@pytest.fixture
def turns(make_rig, drive):
    """Two joints whose positions are commanded, with a clock that a test sets."""
    clock = Clock()
    settings = {
        "drive": drive,
        "node_ids": [1, 2],
        "following_error_deg": 20.0,
        "max_velocity_rpm": 800.0,
        "position_at_start_deg": [0.0, 0.0],
        "heartbeat_timeout": 20.0,
        "feedforward": 1.0 if mode_of(PositionTurnSettings(drive=drive)).offset else 0.0,
    }
    rig = make_rig(
        settings, PositionTurnSettings, axes=2, node_ids=[1, 2], clock=clock,
        motor=EmulatedMotor(gear=GEAR),
    )  # fmt: skip
    with rig:
        rig.tick = clock
        rig.activate()
        yield rig


def led(rig, position, cycles):
    """Commands a position for some periods, and follows it."""
    for _ in range(cycles):
        rig.tick.now += PERIOD
        rig.drives.read()
        rig.drives.write({"position_command": (position,) * 2, "brake": (0.0,)})
    rig.drives._controllers[-1].sample(None)  # what was sent has arrived


def settings_of(rig):
    return [node._setting(Control.POSITION) for node in rig.nodes.nodes]


def test_positions_move_with_the_largest_velocity_and_do_not_jump(turns):
    led(turns, 1.0, 3)
    step = math.floor(800.0 / 60.0 * 2000.0 * PERIOD)
    assert settings_of(turns) == pytest.approx([3 * step] * 2, abs=3)
    offset = mode_of(turns.settings).offset
    if offset is not None:
        told = turns.nodes.nodes[0]._slave.get(offset)
        assert told == pytest.approx(800.0 * turns.nodes.nodes[0]._per_rpm, rel=1e-2)
    turns.drives.write({"position_command": (0.0, 0.0), "brake": (1.0,)})
    turns.wait_for(DriveState.QUICK_STOP_ACTIVE)
    turns.harness.set("wheels.position", (0.05, 0.05))
    turns.wait(lambda: turns.drives.read()["position"] == pytest.approx((0.05,) * 2, abs=COUNT))
    led(turns, math.nan, 2)
    turns.wait_for(DriveState.OPERATION_ENABLED)
    assert settings_of(turns) == pytest.approx([round(0.05 / COUNT)] * 2, abs=1)
    if offset is not None:
        assert turns.nodes.nodes[0]._slave.get(offset) == 0


def test_an_axis_that_does_not_follow_gives_up(turns):
    words = "in fault: EMCY 0x8611 (following error)"
    with pytest.raises(DeviceError) as caught:
        led(turns, 1.0, 2000)
    assert words in str(caught.value)


def test_cyclic_velocities_follow_a_ramp_of_ours(make_rig):
    clock = Clock()
    for name in OTHERS:
        settings = {"drive": name, "mode": 9, "acceleration": 20.0, "heartbeat_timeout": 20.0}
        with make_rig(settings, clock=clock) as rig:
            rig.activate()
            sent = []
            for wanted in (*[1.0] * 8, *[0.0] * 8):
                clock.now += PERIOD
                rig.drives.read()
                rig.drives.write({"velocity_command": (wanted,) * 4, "brake": (0.0,)})
                sent.append(rig.drives._led[0])
            changes = [abs(b - a) for a, b in itertools.pairwise((0.0, *sent))]
            assert max(changes) <= 20.0 * 2.0 * PERIOD + 1e-12
            assert max(sent) == pytest.approx(1.0)
            assert sent[-1] == 0.0
            rig.wait_alone(lambda rig=rig: rig.command == (0.0,) * 4)


def test_currents_and_torques_are_those_of_the_rated_current(make_rig, drive):
    settings = {"drive": drive, "node_ids": [1, 2], "signs": [1, -1], "max_torque_Nm": 8.0,
                "torque_per_current_Nm_A": 4.0, "current_limit_a": 2.0}  # fmt: skip
    motor = EmulatedMotor(gear=GEAR, force_per_current=4.0)
    with make_rig(
        settings, TorqueSettings, axes=2, node_ids=[1, 2], signs=(1, -1), motor=motor
    ) as rig:
        rig.activate()
        resolution = 4.0 * 1e-3 * (1.0 if drive == "epos2" else 1e-3 * RATED)
        near = pytest.approx((2.0, -5.0), abs=resolution)

        def cycle():
            rig.drives.read()
            rig.drives.write({"torque_command": (2.0, -5.0), "brake": (0.0,)})

        rig.wait(lambda: rig.command == near, cycle)
        assert rig.drives.read()["current"] == pytest.approx([0.5, -1.25], abs=1e-3 * RATED / 1e3)
        assert rig.nodes.nodes[0]._slave.get(objects.MODE) == mode_of(rig.settings).number


def test_an_unused_entry_is_in_no_set_up_of_an_epos2():
    written = {entry for kind in KINDS for entry, _ in set_up_of(kind())}
    assert not written & {objects.QUICK_STOP_OPTION, objects.VELOCITY_UNIT, objects.PERIOD}
    assert EPOS2.rated_current is None
    assert Entry(0x6071, 0, "<h") not in written


# --- homing by the drives themselves


def homed(drive, tmp_path, **changes):
    return {
        "drive": drive,
        "node_ids": [1, 2],
        "signs": [1, -1],
        "position_min_mm": [0.0, 0.0],
        "position_max_mm": [900.0, 900.0],
        "position_file": str(tmp_path / "p.json"),
        "homing_method": 37,
        "position_at_home_mm": [700.0, 650.0],
    } | changes


def test_drives_find_their_homes_when_a_reference_is_sought(make_rig, drive, tmp_path):
    motor = EmulatedMotor(gear=2.0 * math.pi / 5e-3, position_offset=4321)
    axes = {"axes": 2, "node_ids": [1, 2], "signs": (1, -1), "motor": motor, "position": 0.2}
    with make_rig(homed(drive, tmp_path), ScrewSettings, **axes) as rig:
        rig.drives.seek_reference()
        rig.activate()
        assert rig.drives.is_referenced
        near = pytest.approx([0.7, 0.65], abs=1e-5)
        assert rig.drives.read()["position"] == near
        mode = mode_of(rig.settings).number
        assert {node._slave.get(objects.MODE) for node in rig.nodes.nodes} == {mode}
        assert set(rig.nodes.states) == {DriveState.OPERATION_ENABLED}
        rig.harness.set("wheels.position", (0.21, 0.21))
        near = pytest.approx([0.71, 0.66], abs=1e-5)
        rig.wait(lambda: rig.drives.read()["position"] == near)
        rig.drives.remember("homed by the drives themselves")


def test_a_home_that_is_not_found_takes_the_power(make_rig, drive, tmp_path):
    settings = homed(drive, tmp_path, homing_method=17)
    axes = {"axes": 2, "node_ids": [1, 2], "signs": (1, -1)}
    with make_rig(settings, ScrewSettings, **axes) as rig:
        rig.drives.seek_reference()
        rig.drives.configure()
        words = "node 1 does not find its home by method 17 (0x6098)"
        assert words in str(refused(rig.drives.activate))
        assert not rig.drives.is_referenced
        rig.wait_for(DriveState.SWITCH_ON_DISABLED)


def test_a_home_needs_its_positions(tmp_path):
    for values in (None, [1.0]):
        settings = homed("epos2", tmp_path, position_at_home_mm=values)
        with pytest.raises(ValueError, match="position_at_home_mm must be 2 values"):
            Cia402Velocities(ScrewSettings(**settings))
