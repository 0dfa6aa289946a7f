"""One EPOS2 controller on its bus: who it is, how it is set up, enabled and read."""

import struct
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

from parapod.systems.hardware import epos2_objects as objects
from parapod.systems.hardware.canopen_bus import CanopenBus
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.ds402 import (
    FAULT_RESET,
    Controlword,
    DriveState,
    is_energised,
    state_of,
    steps_to_operation,
)
from parapod.systems.hardware.epos2_setup import Epos2Params, settings

# How often a state that is waited for is asked for [s].
_POLL = 0.002


class Sample(NamedTuple):
    """What a controller says of its motor.

    Attributes:
        state: of the drive; None if the statusword has none of CiA 402's patterns.
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
        params: Epos2Params,
        beat: Callable[[], None],
        clock: Callable[[], float],
    ):
        """Describes a node.

        Args:
            bus: that it is on.
            node_id: its address.
            params: of the drives.
            beat: sends the heartbeat if it is time.
            clock: monotonic [s].
        """
        self._bus, self._id, self._params = bus, node_id, params
        self._beat, self._clock = beat, clock

    @property
    def report_ids(self) -> list[int]:
        """Identifiers of the frames that answer SYNC."""
        return [pdo.base + self._id for pdo in self._params.reports]

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
        if counts != self._params.counts_per_turn:
            words = f"is set up for {counts} counts per turn, not {self._params.counts_per_turn}"
            raise self._error(words)
        if self._state() is not DriveState.SWITCH_ON_DISABLED:
            self._reset()
        self._bus.manage(self._id, objects.NMT_PRE_OPERATIONAL)
        for entry, value in settings(self._params, self._id):
            self._set(entry, value)
        self._bus.manage(self._id, objects.NMT_START)

    def guard(self, is_guarded: bool) -> None:
        """Has the node stop its motor when this computer falls silent, or not."""
        self._set(objects.HEARTBEAT_CONSUMED, self._params.guard if is_guarded else 0)

    def recover(self) -> None:
        """Resets a fault for want of heartbeats; refuses any other."""
        if self._state() in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            code = self._get(objects.ERROR_CODE) & 0xFFFF
            if code != objects.HEARTBEAT_LOST:
                raise self._faulty(code)
            self.guard(False)
            self._reset()
        # Nodes may leave the operational state when they miss heartbeats (CiA 301, 0x1029).
        self._bus.manage(self._id, objects.NMT_START)

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

    def poll(self) -> Sample:
        """Asks for the newest sample by service data."""
        entries = (entry for pdo in self._params.reports for entry in pdo.entries)
        statusword, *rest = (self._get(entry) for entry in entries)
        return Sample(state_of(statusword), *rest)

    def sample(self, frames: Mapping[int, bytes]) -> Sample:
        """The sample that the node's frames carry."""
        try:
            status, motion = (
                pdo.unpack(frames[pdo.base + self._id]) for pdo in self._params.reports
            )
        except KeyError:
            code = self._bus.emergency(self._id)
            if code is not None:
                raise self._faulty(code) from None
            words = f"does not answer SYNC in {self._params.timeout:g} s"
            raise self._error(words, DeviceFault.SILENT) from None
        except struct.error as error:
            raise self._error(
                f"sends frames of wrong length: {error}", DeviceFault.CORRUPT
            ) from None
        statusword, counts = status
        return Sample(state_of(statusword), counts, *motion)

    def check(self, sample: Sample, is_active: bool) -> None:
        """Refuses what a drive measures that does not do what it should."""
        if sample.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            raise self._faulty(self._bus.emergency(self._id))
        if is_active and not is_energised(sample.state):
            raise self._error(f"has lost its power, it is in {sample.state or 'no known state'}")

    def _reset(self) -> None:
        """Resets a fault once the drive has finished its reaction to it."""
        deadline = self._clock() + self._params.stopping_time
        while self._state() is DriveState.FAULT_REACTION_ACTIVE and self._clock() < deadline:
            time.sleep(_POLL)
        for word in FAULT_RESET:
            self._set(objects.CONTROLWORD, word)
        self._wait_for(DriveState.SWITCH_ON_DISABLED)

    def _wait_for(self, wanted: DriveState) -> None:
        deadline = self._clock() + self._params.state_timeout
        while (state := self._state()) is not wanted:
            if self._clock() > deadline:
                code = self._bus.emergency(self._id)
                words = f", {objects.described(code)}" if code else ""
                raise self._error(f"is in {state or 'no known state'}, not in {wanted}{words}")
            time.sleep(_POLL)

    def _state(self) -> DriveState | None:
        return state_of(self._get(objects.STATUSWORD))

    def _get(self, entry: objects.Entry) -> int:
        self._beat()
        return self._bus.get(self._id, entry)

    def _set(self, entry: objects.Entry, value: int) -> None:
        self._beat()
        self._bus.set(self._id, entry, value)

    def _faulty(self, code: int | None) -> DeviceError:
        words = "no EMCY was seen" if code is None else objects.described(code)
        return self._error(f"is in fault: {words}")

    def _error(self, words: str, fault: DeviceFault = DeviceFault.FAILED) -> DeviceError:
        return DeviceError(self._params.name, f"node {self._id} {words}", fault)
