"""Parameters of drives on EPOS2 controllers, and the settings that they become."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from parapod.systems.core.elementwise import clamp
from parapod.systems.hardware.canopen import HEARTBEAT_PRODUCED, NOT_VALID, Entry, Pdo
from parapod.systems.hardware.epos2 import objects
from parapod.systems.hardware.soft_limits import SoftLimits

type Setting = tuple[Entry, int]

_RPM = 2.0 * math.pi / 60.0  # [rad/s]


@dataclass(frozen=True)
class Epos2Params:
    """Axes driven by motors on EPOS2 24/5 controllers, and the bus that they are on.

    An axis turns or is pushed: its unit below is rad or m. The defaults are the levelling
    platform's wheels.

    Attributes:
        interface: of python-can: "slcan" (serial adapter), "socketcan", or "virtual" (tests).
        channel: of the interface: a serial port, a network interface, any name.
        bitrate: of the bus [bit/s] (EPOS2's default); socketcan has its own.
        node_ids: of the controllers, in the order of the axes.
        gear: by how much the motor turns [rad] for one unit of the axis: the reduction for a
            wheel (section 2.1 of the paper), 2 pi reduction / lead for a screw.
        signs: 1 or -1 of each axis, -1 where the motor's positive direction is the axis's
            negative one; empty: all 1.
        counts_per_turn: encoder counts per turn of the motor [-] (assumption: 500 pulses, of
            which the EPOS2 counts all four edges).
        max_velocity: largest velocity of an axis [unit/s] (assumption: 8000 rpm at the motor).
        acceleration: of an axis that speeds up [unit/s^2] (assumption).
        deceleration: of an axis that slows down [unit/s^2] (assumption).
        quick_stop_deceleration: of an axis that brakes [unit/s^2] (assumption).
        measures_current: whether the motors' currents are measured as well.
        position_at_start: of the axes when the device is configured [unit]; None: not known.
        limits: that no axis leaves; None: none.
        is_synchronous: reads by SYNC and process data, 2 frames per node; otherwise by service
            data, 6 frames per node one after another and 2 more for the current, for buses on
            which others send SYNC.
        master_id: node id under which this computer sends its heartbeat.
        heartbeat_period: least time between two heartbeats [s].
        heartbeat_timeout: silence after which the controllers stop the axes by themselves [s];
            with the time for the quick stop it should be less than 0.2 s.
        timeout: of process data [s].
        sdo_timeout: of service data [s].
        state_timeout: of a change of the drive's state [s]; an EPOS2 measures current offsets
            before it switches on.
        opening_pause: what an SLCAN adapter needs after its port is opened [s]; 2 s for those
            that an opened port resets.
    """

    interface: str = "slcan"
    channel: str = "/dev/ttyACM0"
    bitrate: int = 1_000_000
    node_ids: tuple[int, ...] = (1, 2, 3, 4)
    gear: float = 26.0
    signs: tuple[int, ...] = ()
    counts_per_turn: int = 2000
    max_velocity: float = 8000.0 * _RPM / 26.0
    acceleration: float = 20.0
    deceleration: float = 20.0
    quick_stop_deceleration: float = 100.0
    measures_current: bool = False
    position_at_start: tuple[float, ...] | None = None
    limits: SoftLimits | None = None
    is_synchronous: bool = True
    master_id: int = 127
    heartbeat_period: float = 0.02
    heartbeat_timeout: float = 0.1
    timeout: float = 0.05
    sdo_timeout: float = 0.2
    state_timeout: float = 0.5
    opening_pause: float = 0.0

    def __post_init__(self) -> None:
        ids = (*self.node_ids, self.master_id)
        if len(set(ids)) != len(ids) or len(ids) < 2 or not all(1 <= i <= 127 for i in ids):
            raise ValueError(f"node ids must be different ones of 1..127, not {ids}")
        if self.heartbeat_timeout < 2.0 * self.heartbeat_period:
            raise ValueError(
                f"heartbeat_timeout must be two periods ({self.heartbeat_period} s) or more, "
                f"not {self.heartbeat_timeout} s"
            )
        axes = len(self.node_ids)
        if self.signs and (len(self.signs) != axes or set(self.signs) - {1, -1}):
            raise ValueError(f"signs must be {axes} times 1 or -1, not {self.signs}")
        start = self.position_at_start
        if start is not None and not (len(start) == axes and all(map(math.isfinite, start))):
            raise ValueError(f"position_at_start must be {axes} finite values, not {start}")
        if self.limits is not None and len(self.limits.lower) != axes:
            raise ValueError(f"limits must be {axes}, not {len(self.limits.lower)}")

    @property
    def name(self) -> str:
        """What errors call the controllers."""
        return f"EPOS2 on {self.interface} {self.channel}"

    @property
    def bus_options(self) -> dict[str, Any]:
        """Arguments of `can.Bus`."""
        options: dict[str, Any] = {"interface": self.interface, "channel": self.channel}
        if self.interface != "virtual":
            options["bitrate"] = self.bitrate
        if self.interface == "slcan":
            options["sleep_after_open"] = self.opening_pause
        return options

    @property
    def directions(self) -> tuple[int, ...]:
        """The sign of each axis."""
        return self.signs or (1,) * len(self.node_ids)

    @property
    def reports(self) -> tuple[Pdo, Pdo]:
        """The process data with which a node answers SYNC."""
        motion = objects.MOTION_AND_CURRENT if self.measures_current else objects.MOTION
        return objects.STATUS, motion

    def rpm(self, velocity: float) -> int:
        """Velocity of the motor [rpm] of that of an axis [unit/s], limited; 0 if not finite."""
        if not math.isfinite(velocity):
            return 0
        limited = clamp(velocity, -self.max_velocity, self.max_velocity)
        return round(limited * self.gear / _RPM)

    def velocity(self, rpm: float) -> float:
        """Velocity of an axis [unit/s] of that of its motor [rpm]."""
        return rpm * _RPM / self.gear

    def position(self, counts: float) -> float:
        """Position of an axis [unit] of the counts of its motor's encoder."""
        return counts * 2.0 * math.pi / (self.counts_per_turn * self.gear)

    @property
    def stopping_time(self) -> float:
        """The longest that a quick stop may take [s]."""
        return self.max_velocity / self.quick_stop_deceleration + self.timeout

    @property
    def guard(self) -> int:
        """Value of the heartbeat consumer entry: whose heartbeat, and how long without it [ms]."""
        return self.master_id << 16 | round(1e3 * self.heartbeat_timeout)


def settings(params: Epos2Params, node_id: int) -> Iterator[Setting]:
    """All that a controller must be told before it may be enabled, in order."""

    def motor(acceleration: float) -> int:
        return max(1, round(acceleration * params.gear / _RPM))

    yield objects.MODE, objects.PROFILE_VELOCITY
    yield objects.PROFILE_TYPE, 0
    yield objects.TARGET_VELOCITY, 0
    yield objects.MAX_VELOCITY, params.rpm(params.max_velocity)
    yield objects.ACCELERATION, motor(params.acceleration)
    yield objects.DECELERATION, motor(params.deceleration)
    yield objects.QUICK_STOP_DECELERATION, motor(params.quick_stop_deceleration)
    yield objects.ABORT_CONNECTION, objects.ABORT_BY_QUICK_STOP
    yield HEARTBEAT_PRODUCED, 0
    for index in objects.UNUSED:
        yield Entry(index, 1, "<I"), _unused_id(index, node_id) | NOT_VALID
    for pdo in (objects.COMMAND, *params.reports):
        yield from _mapping(pdo, node_id)


def unwrapped(counts: int, previous: int | None) -> int:
    """A position without the jumps of a 32-bit counter that overflows [counts].

    Args:
        counts: as counted in 32 bits.
        previous: position before; None if this is the first.
    """
    if previous is None:
        return counts
    half = 1 << 31
    return previous + (counts - previous + half) % (1 << 32) - half


def _unused_id(index: int, node_id: int) -> int:
    """Predefined identifier of a process data object (CiA 301)."""
    base = 0x200 if index < 0x1800 else 0x180
    return base + 0x100 * (index & 0x3) + node_id


def _mapping(pdo: Pdo, node_id: int) -> Iterator[Setting]:
    """Sets up a process data object in the order that CiA 301 prescribes: invalid meanwhile."""
    can_id = pdo.base + node_id
    yield Entry(pdo.communication, 1, "<I"), can_id | NOT_VALID
    yield Entry(pdo.communication, 2, "<B"), pdo.transmission
    yield Entry(pdo.mapping, 0, "<B"), 0
    for number, entry in enumerate(pdo.entries, start=1):
        yield Entry(pdo.mapping, number, "<I"), entry.mapping
    yield Entry(pdo.mapping, 0, "<B"), len(pdo.entries)
    yield Entry(pdo.communication, 1, "<I"), can_id
