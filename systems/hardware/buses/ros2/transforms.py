"""Poses of a machine's links on /tf, by ROS 2's own type or in its place.

`tf2_msgs` is not among the packages of ROS 2 on PyPI. Where it is not installed, the same messages
can go out by CycloneDDS, whose types are made as they are used; any node on the graph takes them.
But Fast DDS cannot look up these types, and may then find no topics of ours with standard types.
"""

import importlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from types import new_class
from typing import Any

import numpy as np

from parapod.systems.core.extras import need
from parapod.systems.hardware.buses.bus import Poses

WORLD = "world"
"""Frame of which all links are children."""
# Nodes of this computer find each other without multicast, as those of ROS 2 do on localhost.
_HERE = """<CycloneDDS><Domain>
<General><AllowMulticast>false</AllowMulticast>
<Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""

# Fatal messages and errors of CycloneDDS's log [dds/ddsrt/log.h].
_ERRORS = 0b11


class Writer:
    """Fills messages of any classes with the fields of `tf2_msgs/msg/TFMessage`."""

    def __init__(self, kinds: Mapping[str, Any], publish: Any):
        self._kinds, self._publish = kinds, publish

    def write(self, poses: Poses, nanoseconds: int) -> None:
        """Writes poses at a time [ns]."""
        kinds = self._kinds
        stamp = kinds["Time"](sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        header = kinds["Header"](stamp=stamp, frame_id=WORLD)
        transforms = []
        for name, (position, turn) in poses.items():
            x, y, z = np.asarray(position, dtype=float).tolist()
            w, *axis = np.asarray(turn, dtype=float).tolist()
            transform = kinds["Transform"](
                translation=kinds["Vector3"](x=x, y=y, z=z),
                rotation=kinds["Quaternion"](x=axis[0], y=axis[1], z=axis[2], w=w),
            )
            transforms.append(
                kinds["TransformStamped"](header=header, child_frame_id=name, transform=transform)
            )
        self._publish(kinds["TFMessage"](transforms=transforms))

    def close(self) -> None:
        """Nothing is left open."""


def ros_writer(node: Any) -> Writer | None:
    """By the types of ROS 2; None where they are not installed."""
    try:
        message = importlib.import_module("tf2_msgs.msg").TFMessage
    except ImportError:
        return None
    geometry, std = need("geometry_msgs.msg"), need("std_msgs.msg")
    names = ("Transform", "Vector3", "Quaternion", "TransformStamped")
    kinds = {name: getattr(geometry, name) for name in names}
    kinds |= {"Header": std.Header, "Time": need("builtin_interfaces.msg").Time}
    publisher = node.create_publisher(message, "/tf", 100)
    return Writer(kinds | {"TFMessage": message}, publisher.publish)


class CycloneWriter(Writer):
    """By CycloneDDS, with the names that ROS 2 gives topics and types on the wire."""

    def __init__(self, node: Any, is_local: bool):
        domains, qos = need("cyclonedds.domain"), need("cyclonedds.qos")
        number = node.context.get_domain_id()
        # One of this program may be open already; it is as it was asked for then.
        self._domain = None
        with suppress(need("cyclonedds.core").DDSException):
            self._domain = domains.Domain(number, _HERE) if is_local else None
        self._participant = domains.DomainParticipant(number)
        # It warns of every type of others that it does not know.
        need("cyclonedds.internal").load_cyclonedds().dds_set_log_mask(_ERRORS)
        kinds = _cyclone_types()
        policy = qos.Qos(
            qos.Policy.Reliability.Reliable(max_blocking_time=0), qos.Policy.History.KeepLast(100)
        )
        topic = need("cyclonedds.topic").Topic(
            self._participant, "rt/tf", kinds["TFMessage"], qos=policy
        )
        writer = need("cyclonedds.pub").DataWriter(self._participant, topic, qos=policy)
        super().__init__(kinds, writer.write)
        self._open = writer, topic

    def close(self) -> None:
        """See `Writer`."""
        del self._open, self._participant, self._domain


def _cyclone_types() -> dict[str, Any]:
    """Classes of the messages [ROS 2: builtin_interfaces, std_msgs, geometry_msgs, tf2_msgs]."""
    types = need("cyclonedds.idl.types")
    time = _struct("builtin_interfaces", "Time", {"sec": types.int32, "nanosec": types.uint32})
    header = _struct("std_msgs", "Header", {"stamp": time, "frame_id": str})
    number = types.float64
    vector = _struct("geometry_msgs", "Vector3", dict.fromkeys("xyz", number))
    turn = _struct("geometry_msgs", "Quaternion", dict.fromkeys("xyzw", number))
    transform = _struct("geometry_msgs", "Transform", {"translation": vector, "rotation": turn})
    stamped = _struct(
        "geometry_msgs",
        "TransformStamped",
        {"header": header, "child_frame_id": str, "transform": transform},
    )
    message = _struct("tf2_msgs", "TFMessage", {"transforms": types.sequence[stamped]})
    kinds = (time, header, vector, turn, transform, stamped, message)
    return {kind.__name__: kind for kind in kinds}


def _struct(package: str, name: str, fields: Mapping[str, Any]) -> Any:
    """A class of messages, by its name on the wire."""
    root = need("cyclonedds.idl").IdlStruct
    contents = {"__annotations__": dict(fields), "__module__": __name__}
    kind = {"typename": f"{package}::msg::dds_::{name}_"}
    return dataclass(new_class(name, (root,), kind, lambda space: space.update(contents)))
