"""One EPOS2 controller on its bus: identity, set-up, enabling, commands and samples."""

import struct
import time
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from parapod.systems.hardware.canopen import (
    HEARTBEAT_CONSUMED,
    HEARTBEAT_PRODUCED,
    NMT_PRE_OPERATIONAL,
    NMT_START,
    NOT_VALID,
    CanopenBus,
    Entry,
    Pdo,
)
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.ds402 import (
    FAULT_RESET,
    Controlword,
    DriveState,
    is_energised,
    state_of,
    steps_to_operation,
)
from parapod.systems.hardware.epos2 import objects
from parapod.systems.hardware.epos2.settings import Epos2Settings

# Polling period while waiting for a state or a standstill [s].
POLL = 0.002


# Node id under which this computer sends its heartbeat.
MASTER_ID = 127


class Timing(NamedTuple):
    """Times that depend on bus and controllers, and not on a machine.

    Attributes:
        heartbeat_period: least time between two heartbeats of this computer [s].
        timeout: longest wait for process data [s].
        sdo_timeout: longest wait for service data [s].
        state_timeout: longest change of the drive's state [s]; an EPOS2 measures current offsets
            before it switches on.
    """

    heartbeat_period: float = 0.02
    timeout: float = 0.05
    sdo_timeout: float = 0.2
    state_timeout: float = 0.5


class Sample(NamedTuple):
    """Sample of a motor, as its controller sends it.

    Attributes:
        state: state of the drive; None if the statusword has none of CiA 402's patterns.
        counts: position of the motor.
        rpm: velocity of the motor.
        milliamperes: current of the motor; 0 if it is not measured.
    """

    state: DriveState | None
    counts: int
    rpm: int
    milliamperes: int = 0


class Epos2Controller:
    """A node, as `Epos2` uses it; all methods raise DeviceError and name the node."""

    def __init__(
        self,
        bus: CanopenBus,
        node_id: int,
        settings: Epos2Settings,
        timing: Timing,
        beat: Callable[[], None],
        clock: Callable[[], float],
    ):
        """Describes a node.

        Args:
            bus: that it is on.
            node_id: its address.
            settings: settings of the drives.
            timing: times of bus and drives.
            beat: sends the heartbeat if it is time.
            clock: monotonic [s].
        """
        self._bus, self._id, self._settings, self._timing = bus, node_id, settings, timing
        self._beat, self._clock, self._reports = beat, clock, reports(settings)

    @property
    def report_ids(self) -> list[int]:
        """Identifiers of the frames that answer SYNC."""
        return [pdo.base + self._id for pdo in self._reports]

    def identify(self) -> None:
        """Makes sure that the node is what it should be."""
        try:
            vendor = self._get(objects.VENDOR)
        except DeviceError as error:
            if error.fault is not DeviceFault.SILENT:
                raise
            others = ", ".join(map(str, self._bus.answering())) or "none"
            words = f"does not answer; nodes that do: {others}"
            raise self._error(words, DeviceFault.SILENT) from error
        hardware = self._get(objects.PRODUCT) >> 16
        if (vendor, hardware) != (objects.MAXON, objects.EPOS2_24_5):
            raise self._error(
                f"is vendor 0x{vendor:X}, hardware 0x{hardware:04X}, and not an EPOS2 24/5 "
                f"(0x{objects.MAXON:X}, 0x{objects.EPOS2_24_5:04X})",
                DeviceFault.CORRUPT,
            )

    def set_up(self) -> None:
        """Takes the power, resets a fault, writes all settings and starts the node."""
        self._set(objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE)
        self.guard(False)
        counts = 4 * self._get(objects.ENCODER_PULSES)
        if counts != self._settings.counts_per_turn:
            words = f"is set up for {counts} counts per turn, not {self._settings.counts_per_turn}"
            raise self._error(words)
        if self._state() is not DriveState.SWITCH_ON_DISABLED:
            self._reset()
        self._bus.manage(self._id, NMT_PRE_OPERATIONAL)
        for entry, value in set_up_of(self._settings, self._id):
            self._set(entry, value)
        self._bus.manage(self._id, NMT_START)

    def guard(self, is_guarded: bool) -> None:
        """Has the node stop its motor when this computer falls silent, or not."""
        # Whose heartbeat, and how long without it [ms].
        guard = MASTER_ID << 16 | round(self._settings.heartbeat_timeout_ms)
        self._set(HEARTBEAT_CONSUMED, guard if is_guarded else 0)

    def recover(self) -> None:
        """Resets a fault for want of heartbeats; refuses any other."""
        if self._state() in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            code = self._get(objects.ERROR_CODE) & 0xFFFF
            if code != objects.HEARTBEAT_LOST:
                raise self._faulty(code)
            self.guard(False)
            self._reset()
        # Nodes may leave the operational state when they miss heartbeats (CiA 301, 0x1029).
        self._bus.manage(self._id, NMT_START)

    def enable(self) -> None:
        """Leads the drive to operation enabled at zero velocity, step by step."""
        self._set(objects.TARGET_VELOCITY, 0)
        state = self._state()
        try:
            steps = steps_to_operation(state or DriveState.NOT_READY_TO_SWITCH_ON)
        except ValueError as error:
            raise self._error(str(error)) from error
        for word, reached in steps:
            self._set(objects.CONTROLWORD, word)
            self._wait_for(reached)

    def command(self, word: Controlword, rpm: int) -> None:
        """Sends a controlword and a velocity of the motor [rpm]; nothing confirms them."""
        self._bus.send(objects.COMMAND.base + self._id, objects.COMMAND.pack(word, rpm))

    def steer(self, rpm: int) -> None:
        """Sends a velocity of the motor [rpm], which a drive that does not run ignores."""
        self._bus.send(objects.TARGET.base + self._id, objects.TARGET.pack(rpm))

    def disable(self) -> None:
        """Takes the power, makes sure that it is gone, and lets this computer fall silent.

        A node that keeps its power goes on to wait for heartbeats, without which it stops.
        """
        self._set(objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE)
        deadline = self._clock() + self._timing.state_timeout
        while is_energised(state := self._state()):
            if self._clock() > deadline:
                raise self._error(f"keeps its power, it is in {state}")
            time.sleep(POLL)
        self.guard(False)

    def poll(self) -> Sample:
        """Asks for the newest sample by service data."""
        entries = (entry for pdo in self._reports for entry in pdo.entries)
        statusword, *rest = (self._get(entry) for entry in entries)
        return Sample(state_of(statusword), *rest)

    def sample(self, frames: Mapping[int, bytes]) -> Sample:
        """The sample that the node's frames carry."""
        try:
            status, motion = (pdo.unpack(frames[pdo.base + self._id]) for pdo in self._reports)
        except KeyError:
            code = self._bus.emergency(self._id)
            if code is not None:
                raise self._faulty(code) from None
            words = f"does not answer SYNC in {self._timing.timeout:g} s"
            raise self._error(words, DeviceFault.SILENT) from None
        except struct.error as error:
            raise self._error(
                f"sends frames of wrong length: {error}", DeviceFault.CORRUPT
            ) from None
        statusword, counts = status
        return Sample(state_of(statusword), counts, *motion)

    def check(self, sample: Sample, is_active: bool, is_running: bool) -> None:
        """Refuses what a drive measures that does not do what it should.

        Args:
            sample: newest one.
            is_active: whether the drive should have power.
            is_running: whether it should have obeyed by now that it is not to stop.
        """
        if sample.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            raise self._faulty(self._bus.emergency(self._id))
        if is_active and not is_energised(sample.state):
            raise self._error(f"has lost its power, it is in {sample.state or 'no known state'}")
        if is_running and sample.state is DriveState.QUICK_STOP_ACTIVE:
            raise self._error("stops, which this program did not ask for: is there a stop button?")

    def _reset(self) -> None:
        """Resets a fault once the drive has finished its reaction to it."""
        deadline = self._clock() + stopping_time(self._settings, self._timing)
        while self._state() is DriveState.FAULT_REACTION_ACTIVE and self._clock() < deadline:
            time.sleep(POLL)
        for word in FAULT_RESET:
            self._set(objects.CONTROLWORD, word)
        self._wait_for(DriveState.SWITCH_ON_DISABLED)

    def _wait_for(self, wanted: DriveState) -> None:
        deadline = self._clock() + self._timing.state_timeout
        while (state := self._state()) is not wanted:
            if self._clock() > deadline:
                code = self._bus.emergency(self._id)
                words = f", {objects.described(code)}" if code else ""
                raise self._error(f"is in {state or 'no known state'}, not in {wanted}{words}")
            time.sleep(POLL)

    def _state(self) -> DriveState | None:
        return state_of(self._get(objects.STATUSWORD))

    def _get(self, entry: Entry) -> int:
        self._beat()
        return self._bus.get(self._id, entry)

    def _set(self, entry: Entry, value: int) -> None:
        self._beat()
        self._bus.set(self._id, entry, value)

    def _faulty(self, code: int | None) -> DeviceError:
        words = "no EMCY was seen" if code is None else objects.described(code)
        return self._error(f"is in fault: {words}")

    def _error(self, words: str, fault: DeviceFault = DeviceFault.FAILED) -> DeviceError:
        return DeviceError(self._settings.name, f"node {self._id} {words}", fault)


def set_up_of(settings: Epos2Settings, node_id: int) -> Iterator[tuple[Entry, int]]:
    """Entries that a controller must be told before it may be enabled, in order."""
    stop = settings.quick_stop_deceleration
    yield objects.MODE, objects.PROFILE_VELOCITY
    yield objects.PROFILE_TYPE, 0
    yield objects.TARGET_VELOCITY, 0
    yield objects.MAX_VELOCITY, settings.rpm(settings.max_velocity)
    yield objects.ACCELERATION, settings.rpm_per_second(settings.acceleration)
    yield objects.DECELERATION, settings.rpm_per_second(settings.acceleration)
    yield (
        objects.QUICK_STOP_DECELERATION,
        settings.rpm_per_second(stop),
    )
    yield objects.ABORT_CONNECTION, objects.ABORT_BY_QUICK_STOP
    yield HEARTBEAT_PRODUCED, 0
    for index in objects.UNUSED:
        yield Entry(index, 1, "<I"), _unused_id(index, node_id) | NOT_VALID
    for pdo in (objects.COMMAND, objects.TARGET, *reports(settings)):
        yield from _mapping(pdo, node_id)


def _unused_id(index: int, node_id: int) -> int:
    """Predefined identifier of a process data object (CiA 301)."""
    base = 0x200 if index < 0x1800 else 0x180
    return base + 0x100 * (index & 0x3) + node_id


def _mapping(pdo: Pdo, node_id: int) -> Iterator[tuple[Entry, int]]:
    """Sets up a process data object in the order that CiA 301 prescribes: invalid meanwhile."""
    can_id = pdo.base + node_id
    yield Entry(pdo.communication, 1, "<I"), can_id | NOT_VALID
    yield Entry(pdo.communication, 2, "<B"), pdo.transmission
    yield Entry(pdo.mapping, 0, "<B"), 0
    for number, entry in enumerate(pdo.entries, start=1):
        yield Entry(pdo.mapping, number, "<I"), entry.mapping
    yield Entry(pdo.mapping, 0, "<B"), len(pdo.entries)
    yield Entry(pdo.communication, 1, "<I"), can_id


def reports(settings: Epos2Settings) -> tuple[Pdo, Pdo]:
    """Process data with which a node answers SYNC."""
    motion = objects.MOTION_AND_CURRENT if settings.measures_current else objects.MOTION
    return objects.STATUS, motion


def stopping_time(settings: Epos2Settings, timing: Timing) -> float:
    """Longest time that a quick stop may take [s]."""
    return settings.max_velocity / settings.quick_stop_deceleration + timing.timeout
