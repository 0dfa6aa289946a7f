"""Legs in position mode: what their set values do, whatever is commanded and whatever fails."""

import itertools
import math
import random
import re

import pytest

from parapod.systems.hardware.canopen import Entry, mapping_of, wrapped
from parapod.systems.hardware.cia402 import objects
from parapod.systems.hardware.cia402.controller import Cia402Controller
from parapod.systems.hardware.cia402.emulated_drive import Cia402Node, EmulatedMotor, MeasuredMotor
from parapod.systems.hardware.cia402.makers import EPOS2
from parapod.systems.hardware.cia402.set_up import process_data, set_up_of
from parapod.systems.hardware.cia402.settings import Control, PositionScrewSettings
from parapod.systems.hardware.cia402.states import Controlword, DriveState
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.emulation.canopen_slave import SlaveLine
from parapod.systems.hardware.emulation.harness import Misbehaviour

AXES = 4
COUNT = 5e-3 / (5.0 * 2000.0)  # 0.5 um
START = 0.7
FASTEST = 0.08  # [m/s]
STEP = round(FASTEST * 0.01 / COUNT)  # in a period [counts]
RUNNING, STOPPED = {DriveState.OPERATION_ENABLED}, {DriveState.QUICK_STOP_ACTIVE}


def near(position, error=COUNT):
    return pytest.approx((position,) * AXES, abs=error)


def steps(*numbers):
    """Set values after so many periods at the largest velocity, of which each may lose a count."""
    return pytest.approx([STEP * k for k in numbers], abs=20)


def fault_of(call, *arguments):
    with pytest.raises(DeviceError) as caught:
        call(*arguments)
    return caught.value


# --- what is set up


def test_the_mode_its_set_value_and_the_following_error_are_set_up():
    settings = PositionScrewSettings(reduction=5.0, following_error_mm=3.0, max_velocity_rpm=4000)
    written = [*set_up_of(settings), *mapping_of(process_data(settings, 3), 3)]
    values = dict(written)
    assert values[objects.MODE] == -1
    assert values[objects.MAX_FOLLOWING_ERROR] == 6000
    assert values[objects.MAX_VELOCITY] == 4000
    assert values[Entry(0x1600, 0, "<B")] == 1
    assert values[Entry(0x1600, 1, "<I")] == 0x60400010
    assert values[Entry(0x1601, 0, "<B")] == 1
    assert values[Entry(0x1601, 1, "<I")] == 0x20620020
    unused = {objects.PROFILE_TYPE, objects.TARGET_VELOCITY, objects.ACCELERATION}
    assert not unused & set(values)


def test_a_controlword_travels_without_a_set_value(legs):
    legs.cycle(START, brake=1.0)
    command = EPOS2.modes[Control.POSITION][0].command
    frames = [
        data for can_id, data in legs.frames if command.base < can_id < command.base + AXES + 1
    ]
    assert frames[-AXES:] == [bytes((Controlword.QUICK_STOP, 0))] * AXES


def test_set_values_overflow_as_the_counter_does():
    assert [wrapped(k) for k in (5, -5, (1 << 31), -(1 << 31) - 1)] == [
        5,
        -5,
        -(1 << 31),
        (1 << 31) - 1,
    ]


# --- where the axes go


@pytest.mark.parametrize("is_synchronous", [True, False])
def test_every_axis_goes_where_it_is_commanded_with_its_sign(make_legs, is_synchronous):
    legs = make_legs(is_synchronous=is_synchronous)
    legs.activate()
    wanted = [START + 1e-3 * i for i in range(-2, 2)]
    expected = pytest.approx(wanted, abs=0.51 * COUNT)
    legs.cycle_until(lambda: legs.rig.command == expected, wanted)
    assert not legs.rig.is_braked
    legs.rig.wait(lambda: legs.drives.read()["position"] == pytest.approx(wanted, abs=COUNT))


def test_an_axis_goes_to_a_far_position_with_its_largest_velocity(legs):
    for _ in range(10):
        legs.cycle([START + 0.05, START - 0.05] * 2)
    sent = legs.settings(0), legs.settings(1)
    assert sent[0][-10:] == steps(*range(1, 11))
    assert sent[1][-10:] == steps(*range(-1, -11, -1))


def test_no_command_makes_an_axis_faster_than_its_largest_velocity(legs):
    chance = random.Random(3)
    choices = [1e308, -1e308, math.inf, -math.inf, math.nan, 0.0, 0.601, 0.799, -5.0, 1e9]
    times = []
    for _ in range(150):
        elapsed = chance.choice([1e-3, 0.01, 0.02])
        legs.cycle([chance.choice(choices) for _ in range(AXES)], elapsed=elapsed)
        times.append(elapsed)
    for axis in range(AXES):
        sent = [0, *legs.settings(axis)[-len(times) :]]
        ways = [abs(after - before) for before, after in itertools.pairwise(sent)]
        largest = [FASTEST * t / COUNT + 1e-6 for t in times]
        assert all(way <= allowed for way, allowed in zip(ways, largest, strict=True))
        assert max(ways) > 2 * STEP - 3


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_not_finite_leaves_its_axis_alone_where_it_is(legs, bad):
    for _ in range(3):
        legs.cycle(START + 0.01)
    for _ in range(3):
        legs.cycle([bad, *[START + 0.01] * 3])
    assert legs.settings(0)[-3:] == steps(3, 3, 3)
    assert legs.settings(1)[-3:] == steps(4, 5, 6)


def test_a_pause_is_not_made_up_for(legs):
    legs.cycle(START + 0.01)
    legs.cycle(START + 0.05, elapsed=5.0)
    assert legs.settings(0)[-2:] == steps(1, 3)


def test_commands_end_at_the_ends_of_the_strokes(make_legs):
    for wild, end in ((5.0, 0.8), (-5.0, 0.6)):
        start = end - math.copysign(4e-3, wild)
        legs = make_legs(position=start)
        legs.activate()
        for _ in range(8):
            legs.cycle(wild)
        legs.rig.wait_alone(lambda legs=legs, end=end: legs.rig.command == near(end))
        for axis in range(AXES):
            assert abs(legs.settings(axis)[-1]) == round(4e-3 / COUNT)


def test_an_axis_beyond_its_end_can_only_come_back(make_legs):
    legs = make_legs(position=0.81)
    legs.activate()
    for wanted in (0.9, 0.81, math.nan):
        legs.cycle(wanted)
        assert legs.settings(0)[-1] == 0
    legs.cycle(0.805)
    legs.cycle(0.9)
    assert legs.settings(0)[-2:] == steps(-1, -1)


def test_with_ends_and_without_a_reference_nothing_gets_power(make_legs):
    legs = make_legs(position_at_start_mm=None)
    legs.drives.configure()
    words = str(fault_of(legs.drives.activate))
    assert "the positions are not known, and there are limits" in words
    assert legs.states == {DriveState.SWITCH_ON_DISABLED}


def test_axes_that_look_for_their_ends_have_none_and_little_force(make_legs, tmp_path):
    legs = make_legs(
        position_file=str(tmp_path / "p.json"), homing_current_a=0.4, following_error_mm=2.0
    )
    legs.drives.seek_reference()
    legs.activate()  # although nobody knows the positions
    node = legs.nodes.nodes[0]._slave
    assert node.get(EPOS2.current_limit) == 400
    assert node.get(objects.MAX_FOLLOWING_ERROR) == round(1.0 / COUNT)
    for _ in range(5):
        legs.cycle(-1.0)
    assert legs.settings(0)[-1:] == steps(-5)


# --- no jumps


def test_nothing_jumps_when_the_drives_are_enabled(make_legs):
    legs = make_legs(position=0.7123)
    legs.drives.configure()
    stale = (123_456).to_bytes(4, "little")
    for node in legs.nodes.nodes:
        node._slave.node.set_data(0x2062, 0, stale)  # of the last program
    legs.harness.is_following = False
    legs.harness.set("legs.position", [0.72] * AXES)
    legs.rig.wait(lambda: legs.drives.read()["position"] == near(0.72))
    legs.drives.activate()
    for _ in range(3):
        legs.cycle(math.nan)
    legs.rig.wait_alone(lambda: legs.rig.command == near(0.72))
    assert legs.states == RUNNING
    ends = (pytest.approx(0.72, abs=COUNT), pytest.approx(0.7123, abs=COUNT))
    assert all(x in ends for shown in legs.harness.past for x in shown)


def test_an_axis_that_moves_while_its_drive_is_switched_on_is_enabled_where_it_is(
    make_legs, monkeypatch
):
    legs = make_legs()
    legs.harness.is_following = False
    reach = Cia402Controller._wait_for

    def sink(controller, state):
        reach(controller, state)
        if state is DriveState.SWITCHED_ON:
            legs.harness.set("legs.position", [0.69] * AXES)
            legs.rig.wait_alone(lambda: legs.nodes.nodes[0].measured.position == 0.69)

    monkeypatch.setattr(Cia402Controller, "_wait_for", sink)
    legs.activate()
    legs.cycle(math.nan)
    assert legs.settings(0) == pytest.approx([round((0.69 - START) / COUNT)], abs=1)


def stop_by_brake(legs):
    legs.cycle(START + 0.05, brake=1.0)


def stop_by_button(legs):
    legs.harness.set("legs.emergency_stop", (1.0,))
    legs.cycle_until(lambda: legs.states == STOPPED, START + 0.05)
    legs.harness.set("legs.emergency_stop", (0.0,))
    legs.rig.wait(lambda: legs.drives.read()["emergency_stop"] == [0.0])
    legs.cycle(START + 0.05, brake=1.0)


@pytest.mark.parametrize("stop", [stop_by_brake, stop_by_button], ids=["brake", "emergency stop"])
def test_after_a_stop_an_axis_goes_on_from_where_it_is(legs, stop):
    for _ in range(5):
        legs.cycle(START + 0.05)
    stop(legs)
    legs.rig.wait_alone(lambda: legs.states == STOPPED)
    legs.harness.is_following = False
    legs.harness.set("legs.position", [0.69] * AXES)  # somebody has pushed it
    legs.rig.wait(lambda: legs.drives.read()["position"] == near(0.69))
    legs.frames.clear()
    legs.cycle(START + 0.05)
    legs.cycle(START + 0.05)
    there = round((0.69 - START) / COUNT)
    for axis in range(AXES):
        assert legs.settings(axis) == pytest.approx([there, there + STEP], abs=3)
    legs.rig.wait_alone(lambda: legs.states == RUNNING)


def test_nothing_moves_on_by_itself_after_an_emergency_stop(legs):
    for _ in range(3):
        legs.cycle(START + 0.05)
    legs.harness.set("legs.emergency_stop", (1.0,))
    legs.rig.wait(lambda: legs.drives.read()["emergency_stop"] == [1.0])
    sent = legs.settings(0)
    for is_pressed in (1.0, 0.0):
        legs.harness.set("legs.emergency_stop", (is_pressed,))
        for _ in range(5):
            legs.cycle(START + 0.05)
            assert legs.drives._word is Controlword.QUICK_STOP
        legs.rig.wait(lambda p=is_pressed: legs.drives.read()["emergency_stop"] == [p])
    assert legs.settings(0) == sent
    legs.cycle(START + 0.05, brake=1.0)
    legs.cycle_until(lambda: legs.states == RUNNING, START)


def test_legs_whose_supply_was_cut_begin_again_where_they_are(make_legs):
    legs = make_legs(hold_up=0.0)
    legs.activate()
    for _ in range(3):
        legs.cycle(START + 0.05)
    legs.harness.set("legs.emergency_stop", (1.0,))
    legs.rig.wait_for(DriveState.FAULT)
    legs.rig.wait(lambda: legs.drives.read()["emergency_stop"] == [1.0])
    legs.harness.is_following = False
    legs.harness.set("legs.position", [0.69] * AXES)
    legs.harness.set("legs.emergency_stop", (0.0,))
    legs.drives.deactivate()
    legs.rig.wait(lambda: legs.drives.read()["position"] == near(0.69))
    legs.frames.clear()
    legs.drives.activate()
    legs.cycle(START + 0.05)
    there = round((0.69 - START) / COUNT) + STEP
    assert legs.settings(2) == pytest.approx([there], abs=3)
    assert legs.states == RUNNING


def test_axes_are_not_let_go_before_they_stand(legs):
    legs.harness.set("legs.velocity", [0.0] * 3 + [0.05])
    legs.rig.wait(lambda: legs.drives.read()["velocity"][3] > 0.04)
    legs.cycle(START, brake=1.0)
    for _ in range(5):
        legs.cycle(START)
    legs.rig.wait_alone(lambda: legs.states == STOPPED)
    legs.harness.set("legs.velocity", [0.0] * AXES)
    legs.cycle_until(lambda: legs.states == RUNNING, START)


def test_axes_are_not_let_go_before_a_reading_tells_where_they_are(legs):
    legs.cycle(START, brake=1.0)
    for _ in range(5):
        legs.tick()
        legs.write(START)
    legs.rig.wait_alone(lambda: legs.states == STOPPED)
    legs.drives.read()
    legs.tick(0.2)  # that is long ago
    legs.write(START)
    assert legs.drives._word is Controlword.QUICK_STOP
    legs.cycle(START)
    legs.rig.wait_alone(lambda: legs.states == RUNNING)


def test_a_brake_holds_and_ignores_positions(legs):
    legs.cycle(START, brake=1.0)
    for _ in range(5):
        legs.cycle(START + 0.01, brake=1.0)
    legs.rig.wait_alone(lambda: legs.states == STOPPED)
    assert legs.rig.is_braked
    assert legs.rig.command == near(START)


# --- silence and failures


def test_neutral_leaves_the_axes_where_they_have_been_led(legs):
    for _ in range(5):
        legs.cycle(START + 0.05)
    legs.tick(0.1)
    for _ in range(3):
        legs.drives.neutral()
        legs.tick()
        legs.drives.read()
    led = START + 5 * STEP * COUNT
    legs.rig.wait_alone(lambda: legs.rig.command == near(led, 20 * COUNT))
    assert legs.settings(0)[-3:] == steps(5, 5, 5)
    assert legs.states == RUNNING


def test_neutral_does_not_end_a_brake(legs):
    legs.cycle(START, brake=1.0)
    legs.tick()
    legs.drives.read()
    legs.drives.neutral()
    assert legs.drives._word is Controlword.QUICK_STOP


def test_legs_without_heartbeats_stop_where_they_are_and_recover_there(make_legs):
    legs = make_legs(heartbeat_timeout=0.3)
    legs.activate()
    for _ in range(3):
        legs.cycle(START + 0.05)
    legs.rig.wait_for(DriveState.FAULT)  # no call any more
    stopped = legs.rig.command
    assert stopped == near(START + 3 * STEP * COUNT, 20 * COUNT)
    assert legs.rig.is_braked
    legs.tick()
    assert "EMCY 0x8130 (CAN heartbeat lost)" in str(fault_of(legs.drives.read))
    legs.harness.past.clear()
    legs.drives.activate()
    legs.cycle(math.nan)
    assert legs.rig.command == pytest.approx(stopped, abs=2.0 * COUNT)
    assert all(shown == pytest.approx(stopped, abs=2.0 * COUNT) for shown in legs.harness.past)


def test_a_leg_that_does_not_follow_gives_up_and_the_others_stop(make_legs):
    legs = make_legs(following_error_mm=2.0)
    legs.activate()
    legs.harness.is_following = False
    words = "node 1 is in fault: EMCY 0x8611 (following error)"
    with pytest.raises(DeviceError, match=re.escape(words)):
        legs.cycle_until(lambda: False, [START + 0.01, *[START] * 3])
    legs.rig.wait_alone(lambda: set(legs.nodes.states[1:]) == STOPPED)


def test_while_a_node_is_silent_no_set_value_moves(make_legs):
    legs = make_legs()
    legs.activate()
    for _ in range(3):
        legs.cycle(START + 0.05)
    legs.drives._timing = legs.drives._timing._replace(timeout=0.02)  # of readings from here on
    legs.nodes.disconnect(3)
    for _ in range(15):
        legs.tick()
        assert fault_of(legs.drives.read).fault is DeviceFault.SILENT
        legs.write(START + 0.05)
    # For 0.1 s they went on.
    assert legs.settings(0)[-1] <= 13 * STEP
    assert legs.settings(0)[-5:] == legs.settings(0)[-1:] * 5


def test_garbage_is_told_and_moves_nothing_faster(legs):
    for _ in range(3):
        legs.cycle(START)
    legs.rig.misbehaviour.begin("garbage", 0.0)
    faults = set()
    for _ in range(20):
        legs.tick()
        try:
            legs.drives.read()
        except DeviceError as error:
            faults.add(error.fault)
        legs.write(START)
    assert DeviceFault.CORRUPT in faults
    sent = legs.settings(0)
    assert all(abs(b - a) <= STEP for a, b in itertools.pairwise(sent))
    legs.rig.misbehaviour.end()


# --- the emulated controller


@pytest.fixture
def node(request):
    """A node at 0.5 m in position mode, whose time a test sets; parameter: what it shows there."""
    can = pytest.importorskip("can")
    with can.Bus(interface="virtual", channel="a node alone", ignore_config=True) as bus:
        line = SlaveLine(bus, Misbehaviour(), lambda: 0.0)
        shown = getattr(request, "param", 0)  # 2 counts are 1 um
        motor = EmulatedMotor(1e-3 * 2.0 * math.pi / 1e-6, position_offset=shown, sign=-1)
        node = Cia402Node(1, line, motor, 0.5)
        send(node, objects.MODE, -1)
        send(node, objects.MAX_FOLLOWING_ERROR, 1_000_000)
        yield node


def send(node, entry, value):
    node._slave.node.set_data(entry.index, entry.subindex, entry.pack(value))


def enable(node):
    for word in (Controlword.SHUTDOWN, Controlword.SWITCH_ON, Controlword.ENABLE_OPERATION):
        send(node, objects.CONTROLWORD, word)


@pytest.mark.parametrize("node", [123_456], indirect=True)
def test_an_emulated_axis_comes_to_where_it_shows_what_it_was_set(node):
    enable(node)
    for counts in (123_456, 120_000):
        send(node, EPOS2.modes[Control.POSITION][0].setting, counts)
        node.step(0.0)
        node.measured = MeasuredMotor(node.position)
        assert node._on_read(objects.POSITION.index) == counts


def test_an_emulated_axis_stands_until_its_operation_is_enabled(node):
    send(node, EPOS2.modes[Control.POSITION][0].setting, 4000)
    node.step(0.0)
    assert node.position == 0.5
    enable(node)
    node.step(0.01)
    assert node.position == pytest.approx(0.5 - 4000 * node._way(1.0))
    send(node, objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE)
    send(node, EPOS2.modes[Control.POSITION][0].setting, 0)
    node.step(0.02)
    assert node.position == pytest.approx(0.5 - 4000 * node._way(1.0))


def test_an_emulated_quick_stop_leads_the_axis_down_its_ramp(node):
    enable(node)
    send(node, objects.QUICK_STOP_DECELERATION, 60_000)  # 1000 turns a second, in one
    deceleration = node._way(4.0 * 500.0) * 1000.0
    node.measured = MeasuredMotor(0.5, 0.08)
    node.step(0.0)
    send(node, objects.CONTROLWORD, Controlword.QUICK_STOP)
    step, ticks = 1e-4, 1000
    for k in range(1, ticks):
        node.step(k * step)
    way = 0.08**2 / (2.0 * deceleration)
    assert node.position - 0.5 == pytest.approx(way, rel=0.01)
    assert node.state is DriveState.QUICK_STOP_ACTIVE
    stood = node.position
    node.step(1.0)
    assert node.position == stood
