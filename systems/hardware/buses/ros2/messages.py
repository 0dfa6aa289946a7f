"""Messages of a part as ROS 2 has them: arrays with names, and standard ones by units.

Functions here take and fill messages by their fields, and need no library of ROS 2.
"""

from array import array
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from parapod.systems.core.units import units_of
from parapod.systems.hardware.buses.message import Layout, Message, Signal, Twist, WrongMessage

ARRAY = "std_msgs/msg/Float64MultiArray"
"""Type of a part's own messages."""
STAMP = "stamp"
"""Label of the first value of an array: the sender's time [s]."""

JOINTS, IMU, FIELD = (
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/MagneticField",
)
TWIST, STAMPED, DRIVEN = (
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/TwistWithCovarianceStamped",
)
TOPICS = {JOINTS: "joint_states", IMU: "imu", FIELD: "magnetic_field", DRIVEN: "twist"}
"""Names of the topics of standard messages, beside the part's own."""

# Units of the fields of standard messages; the first field of each type is necessary. Those of
# joints have any number of elements, others x, y and z [ROS 2, sensor_msgs].
_FIELDS: dict[str, dict[str, set[str]]] = {
    JOINTS: {"position": {"m", "rad"}, "velocity": {"m/s", "rad/s"}, "effort": {"N", "N m"}},
    IMU: {"angular_velocity": {"rad/s"}, "linear_acceleration": {"m/s^2"}},
    FIELD: {"magnetic_field": {"T"}},
}
_AXES = ("x", "y", "z")
# Parts of a twist that a machine on wheels follows; it refuses others than zero.
_OF = ("linear", "angular")
_FORWARD, _YAW = (_OF[0], "x"), (_OF[1], "z")
# Unit of switches; those of a part that follows a twist are off meanwhile.
_SWITCH = "-"


def standard(layout: Layout) -> dict[str, dict[str, str]]:
    """Types of standard messages that a part's signals fill, with the signal of each field.

    Args:
        layout: signals of the part, with their units; of two that fit a field the first counts,
            and commands fit none.
    """
    fitting: dict[str, dict[str, str]] = {}
    for kind, fields in _FIELDS.items():
        signals: dict[str, str] = {}
        for field, units in fields.items():
            first = layout.signals.get(next(iter(signals.values()), ""))
            for name, own in layout.signals.items():
                fits = own.size == (3 if kind != JOINTS else first.size if first else own.size)
                if fits and own.size and not name.endswith("_command") and _has(own, units):
                    signals[field] = name
                    break
        if len(signals) == len(fields) or (kind == JOINTS and "position" in signals):
            fitting[kind] = signals
    driven = [name for name in _followed(layout) if not name.endswith("_command")]
    if driven:
        fitting[DRIVEN] = {"twist": driven[0]}
    return fitting


def admissible(layout: Layout) -> set[str]:
    """Types of messages from which all signals of a part follow.

    Args:
        layout: signals of the part, with their units and what follows from a twist.
    """
    others = (signal.unit for signal in layout.signals.values() if not signal.twist)
    is_driven = bool(_followed(layout)) and all(unit == _SWITCH for unit in others)
    twists = {TWIST, STAMPED} if is_driven else set()
    return {ARRAY} | (standard(layout).keys() - {DRIVEN}) | twists


def _has(signal: Signal, units: set[str]) -> bool:
    return bool(signal.unit) and set(units_of(signal.unit, signal.size)) <= units


def _followed(layout: Layout) -> dict[str, Twist]:
    """Signals that follow from a twist."""
    return {name: signal.twist for name, signal in layout.signals.items() if signal.twist}


def joint_names(part: str, size: int) -> list[str]:
    """Names of a part's joints, as in `legs_1`."""
    return [f"{part}_{i + 1}" for i in range(size)]


def fill(
    message: Any,
    kind: str,
    layout: Layout,
    signals: Mapping[str, str],
    values: Mapping[str, Sequence[float]],
) -> None:
    """Puts values into the fields of a standard message; its header is left alone.

    Args:
        message: message of the type.
        kind: the type.
        layout: signals of the part; of its values that follow from a twist, the message has that
            by least squares.
        signals: signal of each field, see `standard`.
        values: values of the signals.
    """
    for field, name in signals.items():
        numbers = values[name]
        if kind == DRIVEN:
            twist = message.twist.twist
            speed, rate = np.linalg.lstsq(np.array(layout.signals[name].twist), numbers)[0]
            twist.linear.x, twist.angular.z = float(speed), float(rate)
        elif kind == JOINTS:
            setattr(message, field, array("d", numbers))
        else:
            vector = getattr(message, field)
            for axis, number in zip(_AXES, numbers, strict=True):
                setattr(vector, axis, float(number))
    if kind == JOINTS:
        message.name = joint_names(layout.part, len(values[signals["position"]]))
    if kind == IMU:
        message.orientation_covariance[0] = -1.0  # it has no orientation


def values_of(kind: str, message: Any, layout: Layout) -> Message:
    """Names and values of a standard message that came.

    Joints are known by the names that `joint_names` gives, or by their order where they have
    others. A twist is followed forward and in yaw.

    Args:
        kind: type of the message.
        message: the message.
        layout: signals that are wanted of it.

    Raises:
        WrongMessage: values that cannot be told apart.
    """
    if kind == TWIST:
        return _driven(message, layout, 0.0)
    stamp = message.header.stamp
    time = stamp.sec + 1e-9 * stamp.nanosec
    if kind == STAMPED:
        return _driven(message.twist, layout, time)
    names: list[str] = []
    values: list[float] = []
    for field, name in standard(layout).get(kind, {}).items():
        size = layout.signals[name].size
        numbers = _field(kind, message, field, joint_names(layout.part, size))
        names += [f"{name}[{i}]" if size > 1 else name for i in range(len(numbers))]
        values += numbers
    return Message(names, values, time)


def _driven(twist: Any, layout: Layout, time: float) -> Message:
    """Commands of a part that follows a twist; its switches are off."""
    parts = {(of, axis): getattr(getattr(twist, of), axis) for of in _OF for axis in _AXES}
    speed, rate = parts.pop(_FORWARD), parts.pop(_YAW)
    for (of, axis), value in parts.items():
        if value != 0.0:
            raise WrongMessage(f"has {value:g} for {of}.{axis}, and {layout.part} cannot follow")
    signals = {name: (0.0,) * signal.size for name, signal in layout.signals.items()}
    for name, steering in _followed(layout).items():
        signals[name] = tuple(forward * speed + yaw * rate for forward, yaw in steering)
    return Message(layout.names, layout.pack(signals), time)


def _field(kind: str, message: Any, field: str, joints: Sequence[str]) -> list[float]:
    content = getattr(message, field)
    if kind != JOINTS:
        return [getattr(content, axis) for axis in _AXES]
    own = list(message.name)
    if len(own) != len(content):
        raise WrongMessage(f"has {len(own)} names of joints for {len(content)} of {field}")
    if set(joints) <= set(own):
        return [content[own.index(name)] for name in joints]
    if len(own) != len(joints):
        raise WrongMessage(f"has the joints {', '.join(own)}, not {', '.join(joints)}")
    return list(content)


def of_array(
    labels: Sequence[tuple[str, int]], values: Sequence[float], layout: Layout
) -> Message:
    """Names and values of an array that came.

    Args:
        labels: its labels, and the number of values of each; none: the values are in the order of
            the layout.
        values: its values.
        layout: signals that are wanted of it.

    Raises:
        WrongMessage: values that cannot be told apart.
    """
    if not labels:
        if len(values) != len(layout.names):
            raise WrongMessage(
                f"has {len(values)} values without labels, not the {len(layout.names)} of "
                f"{', '.join(layout.names)}"
            )
        return Message(layout.names, values, 0.0)
    names = [f"{n}[{i}]" if size > 1 else n for n, size in labels for i in range(size)]
    if len(names) != len(values):
        raise WrongMessage(f"has labels of {len(names)} values for {len(values)}")
    if STAMP not in names:
        return Message(names, values, 0.0)
    at = names.index(STAMP)
    return Message(
        names[:at] + names[at + 1 :], (*values[:at], *values[at + 1 :]), float(values[at])
    )


def labels_of(names: Sequence[str]) -> list[tuple[str, int]]:
    """Labels of an array and the number of values of each, the time's first."""
    labels = {STAMP: 1}
    for name in names:
        signal = name.partition("[")[0]
        labels[signal] = labels.get(signal, 0) + 1
    return list(labels.items())
