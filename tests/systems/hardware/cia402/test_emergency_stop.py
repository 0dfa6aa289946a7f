"""The emergency stop at a digital input, the motors' supply that it cuts, and drives that drop."""

import math
import time

import pytest

from parapod.systems.hardware.cia402 import objects
from parapod.systems.hardware.cia402.device import together
from parapod.systems.hardware.cia402.makers import EPOS2
from parapod.systems.hardware.cia402.set_up import reports
from parapod.systems.hardware.cia402.settings import GearSettings
from parapod.systems.hardware.cia402.states import Controlword, DriveState
from parapod.systems.hardware.device import DeviceError, DeviceFault

NODE, INPUT = 2, 4
STOP = {"stop_node": NODE, "stop_input": INPUT}
CONTACT = {"stop_contact": (NODE, INPUT)}
RUN = {"velocity_command": (2.0,) * 4, "brake": (0.0,)}
HOLD = RUN | {"brake": (1.0,)}
SUPPLIED = 60.0  # so long that the supply stays [s]
STOPPED = {DriveState.QUICK_STOP_ACTIVE}
RUNNING = {DriveState.OPERATION_ENABLED}


@pytest.fixture
def make_stoppable(make_rig):
    """make_stoppable(hold_up, **settings): a rig with an emergency stop at node 2, to be entered.

    Without `hold_up` its contact alone opens, and the motors keep their supply.
    """

    def make(hold_up=SUPPLIED, contact=CONTACT, **settings):
        return make_rig(STOP | settings, hold_up=hold_up, **contact)

    return make


@pytest.fixture
def rig(make_stoppable):
    with make_stoppable() as rig:
        run(rig)
        yield rig


def run(rig):
    rig.activate()
    rig.drives.write(RUN)
    rig.wait(lambda: min(rig.command) > 1.9)


def press(rig, is_pressed=True):
    rig.harness.set("wheels.emergency_stop", (float(is_pressed),))


def shows(rig, is_pressed):
    """Waits until the device shows the emergency stop so."""
    rig.wait(lambda: rig.drives.read()["emergency_stop"] == [float(is_pressed)])


def refused(call):
    with pytest.raises(DeviceError) as caught:
        call()
    assert caught.value.fault is DeviceFault.FAILED
    return caught.value.words


def until_refused(rig, words):
    """Reads until that is refused with words."""
    said = []

    def is_said():
        try:
            rig.drives.read()
        except DeviceError as error:
            said.append(error.words)
        return said and words in said[-1]

    rig.wait_alone(is_said)
    return said[-1]


# --- the contact


@pytest.mark.parametrize("is_synchronous", [True, False])
def test_the_emergency_stop_is_measured_at_every_reading(make_stoppable, is_synchronous):
    with make_stoppable(is_synchronous=is_synchronous) as rig:
        rig.drives.configure()
        assert rig.drives.measures["emergency_stop"] == 1
        for is_pressed in (False, True, False):
            press(rig, is_pressed)
            shows(rig, is_pressed)


def test_without_a_node_for_it_there_is_no_signal(make_rig):
    with make_rig() as rig:
        rig.drives.configure()
        assert "emergency_stop" not in rig.drives.measures
        assert "emergency_stop" not in rig.drives.read()


def test_a_broken_wire_is_a_pressed_stop(rig):
    rig.nodes.is_stop_wire_broken = True
    shows(rig, True)
    rig.wait(lambda: set(rig.nodes.states) == STOPPED)


@pytest.mark.parametrize("number", range(1, 7))
def test_any_digital_input_may_have_the_contact(make_stoppable, number):
    with make_stoppable(stop_input=number, contact={"stop_contact": (NODE, number)}) as rig:
        # A home switch that is low active elsewhere, and a mask that shows nothing.
        node = rig.nodes.nodes[NODE - 1]._slave.node
        node.set_data(0x2071, 2, b"\x00\x00")
        node.set_data(0x2071, 3, b"\xff\xff")
        rig.drives.configure()
        shows(rig, False)
        press(rig)
        shows(rig, True)


def test_the_other_inputs_stay_as_they_are(make_stoppable):
    with make_stoppable() as rig:
        node = rig.nodes.nodes[NODE - 1]._slave
        before = {entry: node.get(entry) for entry in EPOS2.inputs.function}
        words = (EPOS2.inputs.ones[0], EPOS2.inputs.zeros[0], EPOS2.inputs.zeros[1])
        node.node.set_data(0x2071, 3, (0x0107).to_bytes(2, "little"))
        node.node.set_data(0x2071, 4, (0x0007).to_bytes(2, "little"))
        was = [node.get(entry) for entry in words]
        rig.drives.configure()
        changed = EPOS2.inputs.function[INPUT - 1]
        assert node.get(changed) == EPOS2.inputs.bits[INPUT - 1] == 12
        assert all(node.get(e) == v for e, v in before.items() if e != changed)
        bit = 1 << 12
        assert [node.get(entry) & ~bit for entry in words] == [word & ~bit for word in was]


def test_an_input_that_stops_the_drive_itself_is_not_taken(make_stoppable):
    with make_stoppable() as rig:
        node = rig.nodes.nodes[NODE - 1]._slave.node
        node.set_data(0x2070, INPUT, EPOS2.inputs.quick_stop.to_bytes(2, "little"))
        words = refused(rig.drives.configure)
        assert words == "node 2 has its quick stop at digital input 4; give another stop_input"


def test_the_status_frame_of_that_node_alone_carries_the_inputs_and_is_full():
    settings = GearSettings(node_ids=[1, 2, 3, 4], **STOP)
    sizes = {i: [pdo.size for pdo in reports(settings, i)] for i in settings.node_ids}
    assert sizes == {1: [6, 4], 2: [8, 4], 3: [6, 4], 4: [6, 4]}
    status = reports(settings, 2)[0]
    assert [entry.mapping for entry in status.entries] == [0x60410010, 0x60640020, 0x20710110]


# --- what the device does by itself


def test_a_pressed_stop_stops_all_drives_below_the_controller(rig):
    press(rig)
    shows(rig, True)
    for _ in range(20):
        rig.drives.write(RUN)
        rig.drives.read()
    rig.wait(lambda: set(rig.nodes.states) == STOPPED)
    assert rig.command == (0.0,) * 4


def test_the_stop_is_sent_by_the_reading_that_tells_it(rig):
    press(rig)
    shows(rig, True)  # no command comes any more
    rig.wait_alone(lambda: set(rig.nodes.states) == STOPPED)


def test_nothing_moves_on_by_itself_after_the_release(rig):
    press(rig)
    shows(rig, True)
    rig.drives.write(HOLD)  # a brake meanwhile is none after it
    press(rig, False)
    rig.wait_alone(lambda: rig.nodes.nodes[NODE - 1]._inputs[INPUT - 1])
    assert rig.drives.read()["emergency_stop"] == [0.0]
    for _ in range(30):
        rig.drives.write(RUN)
        rig.drives.read()
        time.sleep(5e-3)
    assert set(rig.nodes.states) == STOPPED
    rig.drives.write(HOLD)
    rig.drives.write(RUN)
    rig.wait(lambda: min(rig.command) > 1.9)


@pytest.mark.parametrize("bad", [math.nan, math.inf, 2.0])
def test_a_brake_that_is_neither_0_nor_1_acknowledges_no_emergency_stop(rig, bad):
    press(rig)
    shows(rig, True)
    press(rig, False)
    shows(rig, False)
    rig.drives.write(RUN | {"brake": (bad,)})
    rig.drives.write(RUN)
    assert rig.drives._is_stopped
    rig.drives.write(HOLD)
    rig.drives.write(RUN)
    rig.wait(lambda: min(rig.command) > 1.9)


def test_a_pressed_stop_is_told_by_the_node_that_is_left_when_others_are_silent(rig):
    rig.nodes.disconnect(4)
    press(rig)

    def reads():
        with pytest.raises(DeviceError, match="node 4 does not answer"):
            rig.drives.read()

    rig.wait(lambda: set(rig.nodes.states[:3]) == STOPPED, reads)


def test_a_pressed_stop_is_refused_power(make_stoppable):
    with make_stoppable() as rig:
        press(rig)
        rig.drives.configure()
        shows(rig, True)
        words = refused(rig.drives.activate)
        assert words == (
            "the emergency stop at digital input 4 of node 2 is pressed, or its wire is broken"
        )
        assert set(rig.nodes.states) == {DriveState.SWITCH_ON_DISABLED}
        press(rig, False)
        shows(rig, False)
        run(rig)


# --- the supply


def test_drives_whose_supply_is_cut_are_no_riddle_while_the_stop_is_pressed(make_stoppable):
    with make_stoppable(hold_up=0.0) as rig:
        run(rig)
        press(rig)
        rig.wait_for(DriveState.FAULT)
        shows(rig, True)  # the readings go on, and the guard says what it is
        assert rig.command == (0.0,) * 4
        assert rig.is_braked
        press(rig, False)
        words = until_refused(rig, "EMCY 0x3220 (undervoltage)")
        assert words == (
            "node 1 has no supply for its motor, EMCY 0x3220 (undervoltage): "
            "is the emergency stop pressed?"
        )
        rig.drives.write(RUN)
        assert set(rig.nodes.states) == {DriveState.FAULT}
        # Deactivated, and asked to begin again, the drives have their power back.
        rig.drives.deactivate()
        rig.drives.read()
        rig.drives.activate()
        rig.drives.write(RUN)
        rig.wait(lambda: min(rig.command) > 1.9)


def test_without_a_supply_no_drive_brakes(make_rig):
    with make_rig({"quick_stop_deceleration": 0.1}, hold_up=0.0) as rig:
        run(rig)
        press(rig)
        rig.wait_alone(lambda: DriveState.FAULT in rig.nodes.states)
        rig.wait_alone(lambda: rig.is_braked)
        assert rig.command == (0.0,) * 4  # on the ramp it would take 20 s


def test_a_statusword_without_a_supply_has_no_voltage_enabled(make_stoppable):
    with make_stoppable(hold_up=0.0) as rig:
        run(rig)
        word = rig.drives._bus.get(1, objects.STATUSWORD)
        assert word & 0x0010
        press(rig)
        rig.wait_for(DriveState.FAULT)
        word = rig.drives._bus.get(1, objects.STATUSWORD)
        assert (word & 0x0010, word & 0x004F) == (0, 0x0008)


def test_a_cut_supply_without_a_contact_asks_for_the_emergency_stop(make_rig):
    with make_rig(hold_up=0.0) as rig:
        run(rig)
        press(rig)
        words = until_refused(rig, "no supply")
        assert words.endswith("(undervoltage): is the emergency stop pressed?")


def test_a_lost_supply_is_told_without_anybody_having_pressed_the_stop(make_stoppable):
    with make_stoppable(hold_up=0.05) as rig:
        run(rig)
        rig.harness.set("supply", (0.0,))
        words = until_refused(rig, "no supply")
        assert words.startswith("node 1 has no supply for its motor, EMCY 0x3220")
        rig.wait_for(DriveState.FAULT)
        assert set(rig.command) == {0.0}


def test_drives_are_set_up_and_read_without_their_motors_supply(make_stoppable):
    with make_stoppable(hold_up=0.0) as rig:
        press(rig)
        rig.wait_for(DriveState.FAULT)
        rig.drives.configure()
        assert rig.drives.remarks == [
            "node 1, node 2, node 3, node 4: has no supply for its motor, EMCY 0x3220 "
            "(undervoltage): is the emergency stop pressed?"
        ]
        shows(rig, True)
        press(rig, False)
        shows(rig, False)
        run(rig)


def test_without_a_contact_a_missing_supply_is_refused_power(make_rig):
    with make_rig(hold_up=0.0) as rig:
        press(rig)
        rig.wait_for(DriveState.FAULT)
        rig.drives.configure()
        rig.drives.read()
        assert "node 1 has no supply for its motor" in refused(rig.drives.activate)


def test_another_fault_is_told_while_the_stop_is_pressed(rig):
    press(rig)
    shows(rig, True)
    rig.nodes.trip(3, 0x2310)
    assert "overcurrent" in until_refused(rig, "node 3 is in fault")


# --- the drives' own quick stop


def test_a_quick_stop_at_a_digital_input_of_a_drive_is_named(make_rig):
    with make_rig() as rig:
        node = rig.nodes.nodes[2]
        data = node._slave.node
        run(rig)
        function = EPOS2.inputs.quick_stop
        for index, subindex, value in ((0x2070, 5, function), (0x2071, 2, 32), (0x2071, 4, 32)):
            data.set_data(index, subindex, value.to_bytes(2, "little"))
        time.sleep(0.06)  # they have been running for a while
        node.connect(5, has_voltage=True)
        words = until_refused(rig, "node 3 stops")
        assert words == (
            "node 3 stops, which this program did not ask for: its digital input for a quick stop "
            "is active, as by the emergency stop"
        )
        rig.drives.write(RUN)
        rig.wait_alone(lambda: rig.command[2] == 0.0)


# --- one for all


@pytest.mark.parametrize(
    ("fail", "words"),
    [
        (lambda rig: rig.nodes.trip(3, 0x2310), "is in fault: EMCY 0x2310 (overcurrent)"),
        (
            lambda rig: rig.drives._bus.set(3, objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE),
            "has lost its power, it is in switch on disabled",
        ),
        (
            lambda rig: rig.drives._bus.set(3, objects.CONTROLWORD, Controlword.QUICK_STOP),
            "stops, which this program did not ask for: is there a stop button?",
        ),
    ],
    ids=["fault", "power", "quick stop"],
)
def test_where_axes_share_a_load_the_others_stop_at_the_reading_that_tells_a_failure(
    make_rig, fail, words
):
    names = tuple(f"branch {i}" for i in (11, 12, 13, 21))
    with make_rig({"stops_together": True, "axis_names": names}) as rig:
        run(rig)
        time.sleep(0.06)  # they have been running for a while
        fail(rig)
        assert refused(rig.drives.read) == f"node 3 (branch 13) {words}"
        # That reading has sent it: no other call is needed, and commands do not undo it.
        rig.wait_alone(lambda: set(rig.nodes.states[:2] + rig.nodes.states[3:]) == STOPPED)
        rig.drives.write(RUN)
        time.sleep(0.05)
        assert rig.command == (0.0,) * 4


# --- faults from before


def fail(rig, node_id, code):
    rig.nodes.trip(node_id, code)
    rig.wait_alone(lambda: rig.nodes.states[node_id - 1] is DriveState.FAULT)


def reset(rig, node_id):
    """Resets a fault as another program does."""
    for word in (0, 0x80):
        rig.nodes.nodes[node_id - 1]._slave.node.set_data(0x6040, 0, bytes((word, 0)))


def test_a_fault_from_before_is_told_and_reset(make_rig):
    with make_rig() as rig:
        for node_id, code in ((2, 0x4210), (3, 0x2310), (4, 0x2310)):
            fail(rig, node_id, code)
        rig.drives.configure()
        past = "was in a fault from before, which has been reset"
        assert rig.drives.remarks == [
            f"node 2: {past}: EMCY 0x4210 (overtemperature)",
            f"node 3, node 4: {past}: EMCY 0x2310 (overcurrent)",
        ]
        assert set(rig.nodes.states) == {DriveState.SWITCH_ON_DISABLED}
        # Each is told once.
        rig.drives.close()
        rig.drives.configure()
        assert list(rig.drives.remarks) == []


def test_the_history_of_a_fault_is_told_from_the_newest_to_the_oldest(make_rig):
    with make_rig() as rig:
        for code in (0x2310, 0x3210, 0x7320):
            reset(rig, 4)
            fail(rig, 4, code)
        rig.drives.configure()
        (remark,) = rig.drives.remarks
        assert remark == (
            "node 4: was in a fault from before, which has been reset: EMCY 0x7320 (position "
            "sensor error); before that: EMCY 0x3210 (overvoltage), EMCY 0x2310 (overcurrent)"
        )


def test_a_drive_that_is_well_remembers_what_was(make_rig):
    with make_rig() as rig:
        fail(rig, 1, 0x2310)
        reset(rig, 1)
        rig.drives.configure()
        assert rig.drives.remarks == [
            "node 1: remembers errors from before: EMCY 0x2310 (overcurrent)"
        ]


def test_remarks_of_several_nodes_are_told_once():
    said = {"node 1": ["a"], "node 2": ["b", "a"], "node 3": []}
    assert together(said) == ["node 1, node 2: a", "node 2: b"]
