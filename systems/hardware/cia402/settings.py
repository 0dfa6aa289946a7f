"""Settings of axes on CiA 402 drives, in the units in which people give them.

An axis turns or is pushed: the unit of its SI properties is rad or m. `AxesSettings` declares
every key, and what follows from it; a kind of axes names the keys that it has.
"""

import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, ClassVar, Self

from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.hardware.addresses import resolved
from parapod.systems.hardware.cia402.switches import SwitchGroup, group
from parapod.systems.hardware.soft_limits import SoftLimits

_RPM = 2.0 * math.pi / 60.0  # [rad/s]
# Following error while an axis looks for its end: longer than any stroke [mm].
_UNBOUNDED_MM = 1000.0
# Names in errors; their tables are in `makers`.
_DRIVES = {"epos2": "EPOS2", "epos4": "EPOS4", "nanotec": "Nanotec", "elmo": "Elmo Gold"}

# Keys that a kind of axes has together: of axes that turn and may have ends, share a load, are
# pushed by screws, stop on a ramp, are commanded positions, or have locks and clamps.
_ANGLES = ("position_min_deg", "position_max_deg", "position_at_start_deg")
_LOAD = ("signs", "current_limit_a")
_LENGTHS = ("position_min_mm", "position_max_mm", "position_at_start_mm", "position_file")
_SCREW = ("lead_mm", "reduction", "homing_current_a", *_LENGTHS)
_RAMP = ("homing_method", "homing_speed_rpm", "position_at_home_mm", "quick_stop_mm_s2")
_PLACES = ("command_period_ms", "feedforward")
_LOCKS = ("lock_nodes", "lock_outputs", "lock_inputs")
_CLAMPS = ("clamp_nodes", "clamp_outputs", "clamp_inputs")


class Control(StrEnum):
    """Quantity that is commanded of axes; the drives' mode of operation follows."""

    VELOCITY = "velocity"
    POSITION = "position"
    FORCE = "force"


@dataclass
class DriveSettings(Schema):
    """CiA 402 drives, and the bus that they are on: keys of all axes.

    Attributes:
        part: part of the machine, as in the names of its ports.
        drive: maker's drives that they are, all of them; see `makers`.
        mode: number of the drives' mode of operation (0x6060); null: the usual one of `drive`.
        interface: python-can's name of the bus: "slcan" (serial adapter), "socketcan" (network
            interface), or "virtual" within this process; or "ethercat", which was never tested on
            a wire.
        channel: serial port of the adapter for slcan, network interface for socketcan and
            ethercat, any name for virtual.
        bitrate: speed of the bus [bit/s]; socketcan has its own.
        node_ids: addresses of the controllers, in the order of the axes; on EtherCAT their places
            on the ring, from 1.
        counts_per_turn: encoder counts per turn of the motor, all four edges [-].
        max_velocity_rpm: largest velocity of a motor [rpm].
        heartbeat_timeout_ms: silence after which the controllers stop by themselves [ms]; see
            `Cia402Device`, "Guard".
        opening_pause_ms: pause after the port is opened [ms]; 2000 for SLCAN adapters that this
            resets.
        stop_node: address of the controller at whose digital input is a contact of the emergency
            stop, which is closed while that is not pressed; null: none is measured.
        stop_input: number of that digital input; 4 to 6 of an EPOS2 24/5 take 24 V, and read an
            open contact as a pressed one [EPOS2 24/5 Hardware Reference, 4.5.2].
    """

    part: str = ""
    drive: str = choice("epos2", tuple(_DRIVES))
    mode: int | None = quantity(None, -3, 10)
    interface: str = choice("slcan", ("slcan", "socketcan", "virtual", "ethercat"))
    channel: str = "emulator/can"
    bitrate: int = quantity(1_000_000, 10_000, 1_000_000)
    node_ids: list[int] = quantity([1], 1, 127)
    counts_per_turn: int = quantity(2000, 4, 10_000_000)
    max_velocity_rpm: float = quantity(8000.0, 1.0, 100_000.0)
    heartbeat_timeout_ms: float = quantity(100.0, 40.0, 1000.0)
    opening_pause_ms: float = quantity(0.0, 0.0, 5000.0)
    stop_node: int | None = quantity(None, 1, 127)
    stop_input: int = quantity(4, 1, 6)

    @property
    def heartbeat_timeout(self) -> float:
        """Silence after which the controllers stop by themselves [s]."""
        return 1e-3 * self.heartbeat_timeout_ms

    @property
    def name(self) -> str:
        """Name of the controllers in errors."""
        return f"{_DRIVES[self.drive]} on {self.interface} {self.address}"

    @property
    def address(self) -> str:
        """Place of the interface, an emulator's address resolved."""
        return resolved(self.channel)

    @property
    def place(self) -> str:
        """See `Device`: the adapter's port, wherever this program was started, or the bus."""
        if self.interface != "slcan" or "://" in self.address:
            return self.address
        return os.path.abspath(self.address.partition("@")[0])  # python-can's port@speed

    @property
    def bus_options(self) -> dict[str, Any]:
        """Arguments of `can.Bus`, or of `EthercatBus.open`."""
        if self.interface == "ethercat":
            return {"channel": self.address}
        options: dict[str, Any] = {"interface": self.interface, "channel": self.address}
        if self.interface != "virtual":
            options["bitrate"] = self.bitrate
        if self.interface == "slcan":
            options["sleep_after_open"] = 1e-3 * self.opening_pause_ms
        return options


@dataclass
class AxesSettings(DriveSettings):
    """Axes driven by motors on CiA 402 drives: all further keys, and what follows from them.

    A kind of axes has some of these keys, as `has` tells; the others mean nothing to it.

    Attributes:
        command_period_ms: time between two commands, between whose set values drives in a cyclic
            synchronous mode interpolate (0x60C2) [ms].
        feedforward: share of the set values' velocity that such drives are told beside them
            (0x60B1) [-]; some find it by themselves, and it then counts twice.
        lock_nodes: address of the controller of each lock.
        lock_outputs: number of the digital output that opens each lock.
        lock_inputs: number of the digital input with each lock's contact.
        clamp_nodes: address of the controller of each clamp.
        clamp_outputs: number of the digital output that opens each clamp.
        clamp_inputs: number of the digital input with each clamp's contact.
        signs: 1, or -1 where the motor's positive direction is the axis's negative one, as where
            it retracts; one for each axis.
        current_limit_a: largest current of a motor [A], written at every start; 5 A is what an
            EPOS2 24/5 delivers for long.
        limit_lead_ms: time ahead for which an axis, at its velocity, must still be within its
            ends [ms]; otherwise nothing pushes it outwards.
        position_min_deg: angles below which nothing turns an axis further, one for each axis
            [deg]; null: no ends, and `position_max_deg` is null as well.
        position_max_deg: angles above which nothing turns an axis further [deg]; null: no ends.
        position_at_start_deg: angles of the axes at the start of the program, one for each [deg];
            null: they count from zero since the controllers were switched on. With ends they must
            be known.
        gear: reduction between motor and axis [-].
        lead_mm: way of a screw's nut per turn of the screw [mm].
        reduction: turns of the motor per turn of the screw [-].
        homing_current_a: largest current of a motor while a screw looks for the end of its
            stroke, against which it then pushes no harder [A].
        position_min_mm: lengths below which nothing retracts, one for each axis [mm]; null: the
            machine's.
        position_max_mm: lengths above which nothing extends, one for each axis [mm]; null: the
            machine's.
        position_at_start_mm: measured lengths at the start of the program [mm]; null: not
            measured, so the file must know them.
        position_file: file that keeps the lengths from one program to the next, in the folder in
            which the program is started if it has no other; while there is none, a program
            begins with `position_at_start_mm`.
        homing_method: number of a method by which the drives find their home themselves
            (0x6098) when `parapod home` asks for it; null: it has them look for their ends.
        homing_speed_rpm: velocity of a motor on its way to that home [rpm]; a tenth of it back to
            the switch's edge.
        position_at_home_mm: lengths at that home [mm], one for each axis.
        quick_stop_mm_s2: deceleration with which they stop for want of heartbeats, and to brake
            [mm/s^2].
        acceleration_mm_s2: acceleration with which the drives follow a command, up and down
            [mm/s^2]; a slow ramp delays the loop around them.
        following_error_deg: distance from where it is commanded at which a drive gives up [deg].
        following_error_mm: distance from where it is commanded at which a drive gives up [mm].
        max_force_N: largest force of a slide [N].
        force_per_current_N_A: force of a slide by the current of its motor [N/A], best measured
            with a force cell; in theory the motor's torque constant by the angle of the motor per
            way of the slide.
        max_torque_Nm: largest torque of an axis [N m].
        torque_per_current_Nm_A: torque of an axis by the current of its motor [N m/A]: in theory
            the motor's torque constant by the gear.
    """

    command_period_ms: int = quantity(10, 1, 100)
    feedforward: float = quantity(0.0, 0.0, 1.0)
    lock_nodes: list[int] = quantity([], 1, 127)
    lock_outputs: list[int] = quantity([], 1, 4)
    lock_inputs: list[int] = quantity([], 1, 6)
    clamp_nodes: list[int] = quantity([], 1, 127)
    clamp_outputs: list[int] = quantity([], 1, 4)
    clamp_inputs: list[int] = quantity([], 1, 6)
    signs: list[int] = quantity([1], -1, 1)
    current_limit_a: float = quantity(5.0, 0.05, 10.0)
    limit_lead_ms: float = quantity(20.0, 1.0, 1000.0)
    position_min_deg: list[float] | None = quantity(None, -3600.0, 3600.0)
    position_max_deg: list[float] | None = quantity(None, -3600.0, 3600.0)
    position_at_start_deg: list[float] | None = quantity(None, -3600.0, 3600.0)
    gear: float = quantity(1.0, 0.1, 10000.0)
    lead_mm: float = quantity(5.0, 0.01, 100.0)
    reduction: float = quantity(1.0, 0.01, 10000.0)
    homing_current_a: float = quantity(0.5, 0.05, 10.0)
    position_min_mm: list[float] | None = quantity(None, 0.0, 20_000.0)
    position_max_mm: list[float] | None = quantity(None, 0.0, 20_000.0)
    # No default: a guess would be believed, and the limits would be where they are not.
    position_at_start_mm: list[float] | None = quantity(None, 0.0, 20_000.0)
    position_file: str = "emulator/positions.json"
    homing_method: int | None = quantity(None, -128, 127)
    homing_speed_rpm: float = quantity(100.0, 1.0, 10_000.0)
    position_at_home_mm: list[float] | None = quantity(None, -20_000.0, 20_000.0)
    quick_stop_mm_s2: float = quantity(8000.0, 1.0, 1e6)
    acceleration_mm_s2: float = quantity(8000.0, 1.0, 1e6)
    following_error_deg: float = quantity(5.0, 0.01, 360.0)
    following_error_mm: float = quantity(2.0, 0.01, 1000.0)
    max_force_N: float = quantity(400.0, 0.1, 1e5)  # noqa: N815 (the unit's symbol)
    force_per_current_N_A: float = quantity(100.0, 0.01, 1e5)  # noqa: N815
    max_torque_Nm: float = quantity(20.0, 0.001, 10_000.0)  # noqa: N815
    torque_per_current_Nm_A: float = quantity(5.0, 1e-4, 10_000.0)  # noqa: N815

    # Quantity that is commanded of the axes, and whether they are commanded to brake as well.
    control: ClassVar[Control] = Control.VELOCITY
    has_brake: ClassVar[bool] = True
    # Names of the axes in errors; empty: nodes are named by their addresses alone.
    axis_names: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls, keys: Iterable[str] | None = None, **rest: Any) -> None:
        """Leave a kind of axes these keys of `AxesSettings`; None: those of its base."""
        super().__init_subclass__(**rest)
        if keys is not None:
            others = AxesSettings.__annotations__.keys() - {*keys}
            # A class variable is not a field of a dataclass, though its base has one of that name.
            cls.__annotations__ = dict.fromkeys(others, ClassVar[Any]) | cls.__annotations__

    def has(self, key: str) -> bool:
        """Whether axes of this kind have a key."""
        return key in vars(self)

    @property
    def motor_per_unit(self) -> float:
        """Turn of the motor for one unit of its axis [rad per rad or m]."""
        if self.has("lead_mm"):
            return 2.0 * math.pi * self.reduction / (1e-3 * self.lead_mm)
        return self.gear

    @property
    def rpm_per_unit(self) -> float:
        """Velocity of the motor for that of its axis [rpm per rad/s or m/s]."""
        return self.motor_per_unit / _RPM

    @property
    def directions(self) -> tuple[int, ...]:
        """1 for each axis, -1 where the motor's positive direction is the axis's negative one."""
        return tuple(self.signs) if self.has("signs") else (1,) * len(self.node_ids)

    @property
    def stops_together(self) -> bool:
        """Whether all axes stop at once when one of them fails: those that share a load."""
        return self.has("current_limit_a")

    @property
    def measures_current(self) -> bool:
        """Whether the motors' currents are measured as well."""
        return self.has("current_limit_a")

    @property
    def acceleration(self) -> float:
        """Acceleration of an axis that speeds up or slows down [unit/s^2] (assumption)."""
        return 1e-3 * self.acceleration_mm_s2 if self.has("acceleration_mm_s2") else 20.0

    @property
    def quick_stop_deceleration(self) -> float:
        """Deceleration of an axis that brakes [unit/s^2] (assumption)."""
        return 1e-3 * self.quick_stop_mm_s2 if self.has("quick_stop_mm_s2") else 100.0

    @property
    def seeking(self) -> Self:
        """Settings with which axes look for their ends.

        One that is held up by its end is left behind, and no fault.
        """
        if not self.has("homing_current_a"):
            return self
        settings = replace(self, current_limit_a=self.homing_current_a)
        if self.has("following_error_mm"):
            settings.following_error_mm = _UNBOUNDED_MM
        return settings

    @property
    def position_at_start(self) -> tuple[float, ...] | None:
        """Positions of the axes when the device is configured [unit]; None: not known."""
        return self._positions("position_at_start")

    @property
    def position_at_home(self) -> tuple[float, ...] | None:
        """Positions of the axes at the home that the drives find themselves [unit]."""
        return self._positions("position_at_home")

    def _positions(self, key: str) -> tuple[float, ...] | None:
        """Positions that a key gives in mm or deg [unit]; None: it gives none."""
        if (lengths := vars(self).get(f"{key}_mm")) is not None:
            return tuple(1e-3 * mm for mm in lengths)
        angles = vars(self).get(f"{key}_deg")
        return None if angles is None else tuple(map(math.radians, angles))

    @property
    def positions_path(self) -> str:
        """File that keeps positions from one program to the next; "": none."""
        has_file = self.has("position_file") and self.position_file
        return resolved(self.position_file) if has_file else ""

    @property
    def strokes(self) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        """Least and largest positions of the axes [unit]; None: no ends.

        Raises:
            ValueError: nothing says where they are, or only one of both ends is given.
        """
        lower, upper = self._positions("position_min"), self._positions("position_max")
        if lower is not None and upper is not None:
            return lower, upper
        if self.has("lead_mm"):
            raise ValueError("it needs position_min_mm and position_max_mm")
        if lower is not None or upper is not None:
            raise ValueError(
                "position_min_deg and position_max_deg must be given both, or neither"
            )
        return None

    @property
    def limits(self) -> SoftLimits | None:
        """Limits that no axis leaves whose velocity is commanded; None: none.

        Raises:
            ValueError: they are not in order.
        """
        if self.control is not Control.VELOCITY or (strokes := self.strokes) is None:
            return None
        return SoftLimits(*strokes, self.limit_lead, self.acceleration)

    @property
    def limit_lead(self) -> float:
        """Time by which an axis is kept from its ends early [s]."""
        return 1e-3 * self.limit_lead_ms if self.has("limit_lead_ms") else 0.0

    @property
    def command_signal(self) -> str:
        """Signal with which the axes are commanded."""
        return f"{'torque' if self.has('max_torque_Nm') else self.control}_command"

    @property
    def following_error(self) -> float | None:
        """Error of a position at which a drive gives up [unit]; None: the controllers' own."""
        if self.has("following_error_mm"):
            return 1e-3 * self.following_error_mm
        return math.radians(self.following_error_deg) if self.has("following_error_deg") else None

    @property
    def max_force(self) -> float:
        """Largest force or torque of an axis [N or N m]."""
        return vars(self).get("max_force_N") or vars(self).get("max_torque_Nm", 0.0)

    @property
    def force_per_current(self) -> float:
        """Force or torque of an axis by the current of its motor [N/A or N m/A]; 0: not known."""
        force = vars(self).get("force_per_current_N_A")
        return force or vars(self).get("torque_per_current_Nm_A", 0.0)

    @property
    def switches(self) -> tuple[SwitchGroup, ...]:
        """Locks and clamps, which springs close and digital outputs open.

        Raises:
            ValueError: lists of different lengths.
        """
        groups = (
            group(f"{key}s", key, *(vars(self)[name] for name in names))
            for key, names in (("lock", _LOCKS), ("clamp", _CLAMPS))
            if self.has(names[0])
        )
        return tuple(each for each in groups if each.switches)

    def inputs_of(self, node_id: int) -> Mapping[int, str]:
        """Digital inputs of a node that are measured, and the keys of the settings that say so."""
        inputs = {
            switch.input: f"one under {each.key}_inputs"
            for each in self.switches
            for switch in each.switches
            if switch.node == node_id
        }
        return inputs | ({self.stop_input: "stop_input"} if node_id == self.stop_node else {})

    def outputs_of(self, node_id: int) -> list[int]:
        """Digital outputs of a node that switch something."""
        switches = (switch for each in self.switches for switch in each.switches)
        return sorted(switch.output for switch in switches if switch.node == node_id)

    @property
    def max_velocity(self) -> float:
        """Largest velocity of an axis [unit/s]."""
        return math.radians(6.0 * self.max_velocity_rpm) / self.motor_per_unit

    def rpm(self, velocity: float) -> float:
        """Velocity of the motor [rpm] of that of an axis [unit/s], limited; 0 if not finite."""
        if not math.isfinite(velocity):
            return 0.0
        largest = self.max_velocity_rpm
        return min(max(velocity * self.rpm_per_unit, -largest), largest)

    def velocity(self, rpm: float) -> float:
        """Velocity of an axis [unit/s] of that of its motor [rpm]."""
        return rpm * _RPM / self.motor_per_unit

    def position(self, counts: float) -> float:
        """Position of an axis [unit] of the counts of its motor's encoder."""
        return counts * 2.0 * math.pi / (self.counts_per_turn * self.motor_per_unit)

    def counts(self, position: float) -> float:
        """Counts of the motor's encoder, as a fraction, of the position of its axis [unit]."""
        return position * self.counts_per_turn * self.motor_per_unit / (2.0 * math.pi)


@dataclass
class GearSettings(AxesSettings, keys=["gear"]):
    """Axes that turn behind a gear, such as wheels, and whose velocities are commanded."""


@dataclass
class PositionTurnSettings(AxesSettings, keys=["gear", *_ANGLES, *_PLACES, "following_error_deg"]):
    """Axes that turn behind a gear, and whose positions are commanded."""

    control: ClassVar[Control] = Control.POSITION


@dataclass
class TorqueSettings(
    AxesSettings,
    keys=["gear", *_ANGLES, *_LOAD, "limit_lead_ms", "max_torque_Nm", "torque_per_current_Nm_A"],
):
    """Axes that turn behind a gear, and whose torques are commanded."""

    control: ClassVar[Control] = Control.FORCE


@dataclass
class ScrewSettings(
    AxesSettings, keys=[*_SCREW, *_RAMP, *_LOAD, "acceleration_mm_s2", "limit_lead_ms"]
):
    """Screws that push along strokes, and whose velocities are commanded, within limits.

    Attributes:
        limit_lead_ms: time by which an axis slows down early before its limits [ms]: it could go
            on for so long and still stop in time.
    """

    limit_lead_ms: float = quantity(150.0, 10.0, 1000.0)


@dataclass
class PositionScrewSettings(
    AxesSettings, keys=[*_SCREW, *_RAMP, *_LOAD, *_LOCKS, *_CLAMPS, *_PLACES, "following_error_mm"]
):
    """Screws whose positions are commanded, and locks and clamps at their controllers.

    A slide that is driven by a belt has the circumference of the belt's pulley as its lead.
    """

    control: ClassVar[Control] = Control.POSITION


@dataclass
class ForceSlideSettings(
    AxesSettings, keys=[*_SCREW, *_LOAD, "limit_lead_ms", "max_force_N", "force_per_current_N_A"]
):
    """Slides whose forces are commanded."""

    control: ClassVar[Control] = Control.FORCE
