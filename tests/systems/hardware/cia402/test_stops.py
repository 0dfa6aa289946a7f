"""Stops that somebody else has asked for, and ends that drives do not obey."""

import threading
import time
from contextlib import nullcontext

import pytest

from parapod.diagrams.levelling_platform.drivers import Epos2Wheels
from parapod.diagrams.walking_chair.drivers import Epos2Legs
from parapod.systems.hardware.canopen import HEARTBEAT_CONSUMED
from parapod.systems.hardware.cia402 import device, objects
from parapod.systems.hardware.cia402.controller import Timing, stopping_time
from parapod.systems.hardware.cia402.states import Controlword, DriveState
from parapod.systems.hardware.device import DeviceError, DeviceFault

RUN = {"velocity_command": (2.0,) * 4, "brake": (0.0,)}


@pytest.fixture
def rig(make_rig):
    with make_rig() as rig:
        rig.activate()
        rig.drives.write(RUN)
        rig.wait(lambda: min(rig.command) > 1.9)
        yield rig


def deafen(rig, node_id, to_service_data=False):
    """Has a node obey no process data any more, and no controlword at all if that is wanted."""
    index = rig.nodes._ids.index(node_id)
    node, line = rig.nodes.nodes[index], rig.nodes._lines[index]
    for pdo in (objects.PROFILE_VELOCITY.command, objects.PROFILE_VELOCITY.target):
        del line._subscribers[pdo.base + node_id]
    if to_service_data:
        node._slave.node._write_callbacks.remove(node._on_write)


def test_a_quick_stop_that_is_not_ours_is_told_and_never_ended(rig, until):
    time.sleep(0.06)  # they have been running for a while
    rig.drives._bus.set(4, objects.CONTROLWORD, Controlword.QUICK_STOP)
    for _ in range(20):
        rig.drives.write(RUN)
    assert until(lambda: rig.command[3] == 0.0)
    assert rig.nodes.states[3] is DriveState.QUICK_STOP_ACTIVE
    with pytest.raises(DeviceError, match="node 4 stops, which this program did not ask for") as e:
        rig.drives.read()
    assert e.value.fault is DeviceFault.FAILED
    rig.drives.write(RUN)
    assert rig.nodes.states[3] is DriveState.QUICK_STOP_ACTIVE
    assert min(rig.command[:3]) > 1.9


def test_a_quick_stop_of_ours_is_none_of_somebody_else_s(rig):
    for brake in (1.0, 0.0, 1.0, 0.0):
        rig.drives.write(RUN | {"brake": (brake,)})
        rig.drives.read()
        wanted = DriveState.QUICK_STOP_ACTIVE if brake else DriveState.OPERATION_ENABLED
        rig.wait(lambda wanted=wanted: set(rig.nodes.states) == {wanted})
        rig.drives.read()
    rig.wait(lambda: min(rig.command) > 1.9)


def test_a_drive_that_misses_the_release_of_a_stop_of_ours_asks_for_no_button(rig):
    rig.drives.write(RUN | {"brake": (1.0,)})
    rig.wait(lambda: set(rig.nodes.states) == {DriveState.QUICK_STOP_ACTIVE})
    deafen(rig, 4)
    rig.drives.write(RUN)
    said = []

    def is_refused():
        try:
            rig.drives.read()
        except DeviceError as error:
            said.append(error.words)
        return said

    rig.wait_alone(is_refused)
    assert said[0] == (
        "node 4 stays in a quick stop of this program, and has not obeyed its release"
    )


def test_a_brake_is_one_above_a_half(rig):
    rig.drives.write(RUN | {"brake": (0.5,)})
    time.sleep(0.05)
    assert set(rig.nodes.states) == {DriveState.OPERATION_ENABLED}
    rig.drives.write(RUN | {"brake": (0.51,)})
    rig.wait(lambda: set(rig.nodes.states) == {DriveState.QUICK_STOP_ACTIVE})


def test_drives_that_need_a_while_to_stop_have_it(rig):
    rig.harness.set("wheels.velocity", (0.0, 0.0, 2.0, 0.0))
    standing = threading.Timer(0.2, rig.harness.set, ("wheels.velocity", (0.0,) * 4))
    began = time.monotonic()
    standing.start()
    rig.drives.deactivate()
    assert time.monotonic() - began >= 0.2
    assert set(rig.nodes.states) == {DriveState.SWITCH_ON_DISABLED}


@pytest.mark.parametrize(("times", "confirmed"), [(2, True), (1000, False)])
def test_a_node_that_is_silent_while_it_stops_is_asked_again_for_as_long(
    rig, monkeypatch, times, confirmed
):
    ask, left = rig.drives._samples, [times]

    def samples():
        left[0] -= 1
        if left[0] >= 0:
            raise DeviceError("EPOS2", "node 3 does not answer SYNC", DeviceFault.SILENT)
        return ask()

    monkeypatch.setattr(rig.drives, "_samples", samples)
    with nullcontext() if confirmed else pytest.raises(DeviceError, match="node 3 does not"):
        rig.drives.deactivate()
    assert (left[0] < 0) is confirmed
    assert set(rig.nodes.states) == {DriveState.SWITCH_ON_DISABLED}


@pytest.mark.parametrize("driver", [Epos2Legs(), Epos2Wheels()], ids=["screws", "wheels"])
def test_an_axis_that_lags_behind_its_ramp_has_time_to_stop(driver):
    settings, lag, step = driver, 0.04, 1e-4
    asked = speed = settings.max_velocity
    elapsed = 0.0
    while settings.rpm(speed) > 60:
        asked = max(0.0, asked - settings.quick_stop_deceleration * step)
        speed += (asked - speed) * step / lag
        elapsed += step
    assert elapsed < stopping_time(settings, Timing(timeout=0.0)) < 2.0


def test_a_node_that_obeys_no_process_data_is_stopped_by_service_data(rig):
    deafen(rig, 3)
    rig.harness.set("wheels.velocity", (0.0, 0.0, 2.0, 0.0))
    with pytest.raises(DeviceError, match=r"node 3 does not stop: \d+ rpm"):
        rig.drives.deactivate()
    assert set(rig.nodes.states) == {DriveState.SWITCH_ON_DISABLED}
    assert rig.command == (0.0,) * 4


def test_a_node_that_keeps_its_power_is_told_and_goes_on_to_wait_for_heartbeats(rig, until):
    deafen(rig, 3, to_service_data=True)
    with pytest.raises(DeviceError, match="node 3 keeps its power, it is in operation enabled"):
        rig.drives.deactivate()
    disabled = {DriveState.SWITCH_ON_DISABLED}
    assert {*rig.nodes.states[:2], rig.nodes.states[3]} == disabled
    # Nobody sends any: it stops by itself.
    assert until(lambda: rig.nodes.states[2] is DriveState.FAULT)
    assert rig.command == (0.0,) * 4


def test_nodes_behind_silent_ones_are_asked_before_other_devices_have_waited_for_long(
    make_rig, monkeypatch
):
    monkeypatch.setattr(device, "_CONFIRMING", 1.0)
    with make_rig({"sdo_timeout": 0.6, "timeout": 0.05}) as rig:
        rig.activate()
        for node_id in (1, 2, 3):
            rig.nodes.disconnect(node_id)
        with pytest.raises(DeviceError, match="node 1 does not answer"):
            rig.drives.deactivate()
        assert rig.nodes.states[3] is DriveState.SWITCH_ON_DISABLED
        # It has been asked, and waits for heartbeats no more.
        assert rig.nodes.nodes[3]._slave.get(HEARTBEAT_CONSUMED) == 0
        assert rig.drives._bus.sdo_timeout == 0.6


def test_drives_wait_for_two_heartbeats_at_least(make_rig):
    period = {"heartbeat_period": 0.02}
    make_rig(period | {"heartbeat_timeout": 0.04})
    with pytest.raises(ValueError, match=r"heartbeat_timeout must be two periods \(0.02 s\)"):
        make_rig(period | {"heartbeat_timeout": 0.039})
