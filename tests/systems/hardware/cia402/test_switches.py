"""Locks and clamps at digital outputs, and their contacts at digital inputs."""

import contextlib
import math
import threading

import pytest

from parapod.systems.hardware.canopen import NOT_VALID, Entry, mapping_of
from parapod.systems.hardware.cia402.controller import Cia402Controller
from parapod.systems.hardware.cia402.makers import EPOS2
from parapod.systems.hardware.cia402.positions import Cia402Positions
from parapod.systems.hardware.cia402.set_up import outputs_pdo, process_data, reports, set_up_of
from parapod.systems.hardware.cia402.settings import AxesSettings, PositionScrewSettings
from parapod.systems.hardware.cia402.states import DriveState
from parapod.systems.hardware.cia402.switches import (
    Switch,
    SwitchBoard,
    SwitchGroup,
    switches_of_limbs,
)
from parapod.systems.hardware.device import DeviceError

LIMBS, LOCKS = 2, 8
START = 0.7
STOPPED = {DriveState.QUICK_STOP_ACTIVE}
ALL_CLOSED = (1.0,) * LOCKS, (1.0,) * LIMBS
# Limb 2 is loose: its locks are closed, all others and its clamp are open.
LOOSE = (0.0,) * 4 + (1.0,) * 4, (1.0, 0.0)


def wires(legs):
    return legs.wire("locks.command"), legs.wire("clamps.command")


def switch(legs, wanted, brake=0.0, timeout=None):
    """Commands locks and clamps, and waits until their wires say so."""
    locks, clamps = wanted
    legs.cycle(START, brake, locks=locks, clamps=clamps)
    legs.rig.wait_alone(lambda: wires(legs) == wanted)


def flush(legs):
    """Waits until the nodes have obeyed all that has been sent."""
    for controller in legs.drives._controllers:
        controller.sample(None)


# --- commands


def test_each_switch_obeys_its_own_output(legs):
    for i in range(LOCKS):
        locks = tuple(float(k != i) for k in range(LOCKS))
        switch(legs, (locks, (1.0,) * LIMBS))
        node, output = legs.nodes.nodes[2 * (i // 4)], i % 4
        assert node.outputs == tuple(k == output for k in range(4))
    for i in range(LIMBS):
        switch(legs, ((1.0,) * LOCKS, tuple(float(k != i) for k in range(LIMBS))))
        assert legs.nodes.nodes[2 * i + 1].outputs == (True, False, False, False)


def test_nothing_is_opened_before_it_is_commanded_with_power(make_legs):
    legs = make_legs()
    legs.drives.configure()
    legs.write(START, locks=(0.0,) * LOCKS, clamps=(0.0,) * LIMBS)
    flush(legs)
    assert wires(legs) == ALL_CLOSED
    legs.activate()
    legs.cycle(START)  # legs alone
    flush(legs)
    assert wires(legs) == ALL_CLOSED


def test_a_start_closes_what_a_killed_program_has_left_open(make_legs, monkeypatch):
    legs = make_legs()
    legs.activate()
    switch(legs, LOOSE)
    legs.drives._bus.close()
    assert wires(legs) == LOOSE
    assert legs.states == {DriveState.OPERATION_ENABLED}
    states, put = [], legs.harness.set

    def seen(name, values):
        if name.endswith(".command") and tuple(values) != legs.wire(name):
            states.append(legs.states)
        put(name, values)

    monkeypatch.setattr(legs.harness, "set", seen)
    with contextlib.closing(Cia402Positions(legs.rig.settings, legs.drives._timing)) as second:
        second.configure()
        legs.rig.wait_alone(lambda: wires(legs) == ALL_CLOSED)
    # No axis had power any more.
    assert states
    assert all(each == {DriveState.SWITCH_ON_DISABLED} for each in states)


@pytest.mark.parametrize(("wanted", "is_closed"), [(0.5, 0.0), (0.51, 1.0), (-0.5, 0.0)])
def test_a_switch_is_closed_by_a_command_above_a_half(legs, wanted, is_closed):
    switch(legs, LOOSE)
    legs.cycle(START, locks=(wanted,) * LOCKS, clamps=LOOSE[1])
    legs.rig.wait_alone(lambda: legs.wire("locks.command") == (is_closed,) * LOCKS)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -1.0, 2.0])
def test_a_command_that_is_neither_0_nor_1_opens_nothing_and_closes_what_stands(bad):
    group = SwitchGroup("locks", "lock", (Switch(1, 1, 1), Switch(1, 2, 2)))
    board = SwitchBoard([group])
    board.obey({"locks.command": (0.0, 1.0)}, may_open=True, stands=False)
    board.obey({"locks.command": (bad, bad)}, may_open=True, stands=False)
    assert board.outputs_on(1) == {1}
    board.obey({"locks.command": (bad, bad)}, may_open=True, stands=True)
    assert board.outputs_on(1) == set()


def test_legs_whose_locks_are_commanded_nonsense_stop_before_these_close(legs):
    switch(legs, LOOSE)
    legs.harness.set("legs.velocity", [0.05] * len(legs.node_ids))
    broken = {"locks": (math.nan, *LOOSE[0][1:]), "clamps": LOOSE[1]}
    legs.cycle_until(lambda: legs.states == STOPPED, START, **broken)
    legs.cycle(START, **broken)
    flush(legs)
    assert wires(legs) == LOOSE
    legs.harness.set("legs.velocity", [0.0] * len(legs.node_ids))
    closed = (1.0, *LOOSE[0][1:]), LOOSE[1]
    legs.cycle_until(lambda: wires(legs) == closed, START, **broken)
    assert legs.states == STOPPED


def test_locks_and_clamps_are_switched_while_the_axes_are_braked(legs):
    switch(legs, LOOSE, brake=1.0)
    switch(legs, ALL_CLOSED, brake=1.0)
    assert legs.states == STOPPED


def test_what_a_node_does_with_other_outputs_stays_as_it_is(make_legs):
    legs = make_legs(lock_nodes=[1], lock_outputs=[2], lock_inputs=[2])
    node = legs.nodes.nodes[0]._slave
    others = 0xA101  # outputs 1 and 3, H, and a fault
    for entry, value in ((EPOS2.outputs.ones[0], others), (EPOS2.outputs.state, others)):
        node.node.set_data(entry.index, entry.subindex, entry.pack(value))
    node.node.set_data(0x2078, 3, EPOS2.outputs.zeros[0].pack(0x6000))
    legs.activate()
    for is_closed in (0.0, 1.0, 0.0):
        legs.cycle(START, locks=(is_closed,), clamps=(1.0,) * LIMBS)
        legs.rig.wait_alone(lambda c=is_closed: legs.wire("locks.command") == (c,))
        assert node.get(EPOS2.outputs.state) == others | (0 if is_closed else 0x4000)
    legs.drives.deactivate()
    assert node.get(EPOS2.outputs.state) == others
    assert node.get(EPOS2.outputs.ones[0]) == others | 0x4000
    assert node.get(EPOS2.outputs.zeros[0]) == 0x2000
    assert node.get(EPOS2.outputs.function[1]) == 14


# --- contacts


@pytest.mark.parametrize("is_synchronous", [True, False])
def test_contacts_show_what_is_closed_whatever_is_commanded(make_legs, is_synchronous):
    legs = make_legs(is_synchronous=is_synchronous)
    legs.drives.configure()
    assert legs.drives.measures["locks.closed"] == LOCKS
    assert legs.drives.measures["clamps.closed"] == LIMBS
    for locks, clamps in (((1.0, 0.0, 0.0, 1.0) * 2, (0.0, 1.0)), LOOSE):
        legs.harness.set("locks.closed", locks)
        legs.harness.set("clamps.closed", clamps)

        def shows(locks=locks, clamps=clamps):
            shown = legs.drives.read()
            return (*shown["locks.closed"], *shown["clamps.closed"]) == (*locks, *clamps)

        legs.rig.wait(shows)


def test_a_broken_wire_says_that_a_switch_is_not_closed(legs):
    legs.harness.set("locks.closed", (1.0,) * LOCKS)
    legs.rig.wait(lambda: legs.drives.read()["locks.closed"] == [1.0] * LOCKS)
    legs.nodes.broken_wires.add(("locks", 5))
    broken = [float(i != 5) for i in range(LOCKS)]
    legs.rig.wait(lambda: legs.drives.read()["locks.closed"] == broken)
    legs.nodes.broken_wires.clear()
    legs.rig.wait(lambda: legs.drives.read()["locks.closed"] == [1.0] * LOCKS)


def test_a_clamp_and_the_emergency_stop_share_a_node(legs):
    for closed, pressed in ((1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)):
        legs.harness.set("clamps.closed", (closed, 0.0))
        legs.harness.set("legs.emergency_stop", (pressed,))

        def shows(closed=closed, pressed=pressed):
            shown = legs.drives.read()
            return (shown["clamps.closed"][0], shown["emergency_stop"][0]) == (closed, pressed)

        legs.rig.wait(shows)


def test_an_input_that_stops_the_drive_itself_is_not_taken(make_legs):
    legs = make_legs()
    data = EPOS2.inputs.quick_stop.to_bytes(2, "little")
    legs.nodes.nodes[2]._slave.node.set_data(0x2070, 3, data)
    with pytest.raises(DeviceError) as caught:
        legs.drives.configure()
    assert caught.value.words == (
        "node 3 has its quick stop at digital input 3; give another one under lock_inputs"
    )


# --- on the bus


def test_only_nodes_with_outputs_have_a_frame_for_them():
    limbs = switches_of_limbs(3) | {"clamp_nodes": [2, 4, 4]}
    limbs |= {"clamp_outputs": [1, 1, 2], "clamp_inputs": [1, 1, 2]}
    settings = PositionScrewSettings(node_ids=[1, 2, 3, 4, 5, 6], **limbs)
    for node_id in settings.node_ids:
        values = dict(
            [*set_up_of(settings), *mapping_of(process_data(settings, node_id), node_id)]
        )
        has_some = node_id != 6
        assert values[Entry(0x1402, 1, "<I")] == (
            0x400 + node_id if has_some else 0x400 + node_id | NOT_VALID
        )
        assert (values.get(Entry(0x1602, 1, "<I")) == 0x20780110) is has_some
        assert values[Entry(0x1403, 1, "<I")] == 0x500 + node_id | NOT_VALID
        assert [pdo.size for pdo in reports(settings, node_id)] == [8 if has_some else 6, 6]


# --- what goes wrong


def test_neutral_neither_opens_nor_closes_anything(legs):
    switch(legs, LOOSE)
    for _ in range(3):
        legs.tick()
        legs.drives.read()
        legs.drives.neutral()
    flush(legs)
    assert wires(legs) == LOOSE
    switch(legs, ALL_CLOSED)
    legs.drives.neutral()
    flush(legs)
    assert wires(legs) == ALL_CLOSED


def test_switches_stay_when_heartbeats_stay_away(make_legs):
    legs = make_legs(heartbeat_timeout=0.3)
    legs.activate()
    switch(legs, LOOSE)
    legs.rig.wait_for(DriveState.FAULT)
    assert wires(legs) == LOOSE


def press(legs, is_pressed):
    legs.harness.set("legs.emergency_stop", (float(is_pressed),))
    legs.rig.wait(lambda: legs.drives.read()["emergency_stop"] == [float(is_pressed)])


def test_a_pressed_stop_leaves_what_is_open_and_lets_nothing_be_opened(legs):
    switch(legs, LOOSE)
    press(legs, True)
    some = (1.0,) * 4 + (0.0,) * 4, (0.0,) * 2
    legs.cycle(START, locks=some[0], clamps=some[1])
    flush(legs)
    legs.rig.wait_alone(lambda: wires(legs)[0][:4] == (1.0,) * 4)  # what is closed is closed
    assert wires(legs) == ((1.0,) * LOCKS, LOOSE[1])
    press(legs, False)
    legs.cycle(START, locks=some[0], clamps=some[1])
    flush(legs)
    assert wires(legs) == ((1.0,) * LOCKS, LOOSE[1])
    switch(legs, some, brake=1.0)


def test_nothing_is_opened_after_a_drive_has_failed(legs):
    legs.nodes.trip(3, 0x2310)
    legs.tick()
    with pytest.raises(DeviceError, match="node 3 is in fault"):
        legs.drives.read()
    legs.write(START, locks=LOOSE[0], clamps=LOOSE[1])
    flush(legs)
    assert wires(legs) == ALL_CLOSED


@pytest.mark.parametrize("end", ["deactivate", "close"])
def test_an_end_closes_all_once_the_axes_stand(legs, end):
    switch(legs, LOOSE)
    legs.harness.set("legs.velocity", (0.0, 0.0, 0.05, 0.0))
    ending = threading.Thread(target=getattr(legs.drives, end))
    ending.start()
    legs.rig.wait_alone(lambda: legs.states == STOPPED)
    ending.join(0.1)
    assert ending.is_alive()
    assert wires(legs) == LOOSE
    legs.harness.set("legs.velocity", (0.0,) * 4)
    ending.join(5.0)
    legs.rig.wait_alone(lambda: wires(legs) == ALL_CLOSED)
    assert legs.states == {DriveState.SWITCH_ON_DISABLED}


def test_an_end_closes_what_it_can_when_a_node_is_silent(make_legs):
    legs = make_legs()
    legs.activate()
    switch(legs, LOOSE)
    legs.nodes.disconnect(1)
    legs.drives._bus._nodes[1].sdo.RESPONSE_TIMEOUT = 0.02  # of this one alone, which says nothing
    with pytest.raises(DeviceError, match="node 1 does not answer"):
        legs.drives.deactivate()
    left = LOOSE[0][:4] + (1.0,) * 4, (1.0,) * 2
    legs.rig.wait_alone(lambda: wires(legs) == left)


def test_an_end_closes_all_also_when_no_node_has_time_to_confirm_it(legs, monkeypatch):
    switch(legs, LOOSE)

    def disable(controller):
        legs.tick(1.0)
        raise DeviceError(controller.name, "keeps its power")

    monkeypatch.setattr(Cia402Controller, "disable", disable)
    with pytest.raises(DeviceError, match="node 1: keeps its power"):
        legs.drives.deactivate()
    legs.rig.wait_alone(lambda: wires(legs) == ALL_CLOSED)


def test_an_end_makes_sure_that_all_is_closed(legs):
    switch(legs, LOOSE)
    # Frames with process data of the outputs are lost.
    for node, line in zip(legs.node_ids, legs.nodes._lines, strict=True):
        line._subscribers.pop(outputs_pdo(AxesSettings()).base + node)
    legs.drives.deactivate()
    legs.rig.wait_alone(lambda: wires(legs) == ALL_CLOSED)


def test_a_next_activation_opens_nothing_by_itself(legs):
    switch(legs, LOOSE)
    legs.drives.deactivate()
    legs.drives.activate()
    legs.cycle(START)
    flush(legs)
    assert wires(legs) == ALL_CLOSED


def test_garbage_opens_nothing(legs):
    switch(legs, LOOSE)
    legs.rig.misbehaviour.begin("garbage", 0.0)
    for _ in range(10):
        legs.tick()
        with contextlib.suppress(DeviceError):
            legs.drives.read()
        legs.write(START, locks=LOOSE[0], clamps=LOOSE[1])
        assert wires(legs) == LOOSE
    legs.rig.misbehaviour.end()
