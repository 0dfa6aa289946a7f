"""ROS 2 by its own library: a managed node whose topics are the channels of parts."""

import os
import threading
from array import array
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from typing import Any

from parapod.systems.core.extras import need
from parapod.systems.hardware.buses.address import ROS2, Address
from parapod.systems.hardware.buses.bus import Bus, Inbox, Poses
from parapod.systems.hardware.buses.message import Layout, Message, WrongMessage
from parapod.systems.hardware.buses.ros2.messages import (
    ARRAY,
    TOPICS,
    fill,
    labels_of,
    standard,
    values_of,
)
from parapod.systems.hardware.buses.ros2.transforms import TransformWriter
from parapod.systems.hardware.clock import monotonic
from parapod.systems.hardware.device import DeviceError, DeviceFault

# Key of the environment that says how far ROS 2 looks for other nodes, and what the user's said.
_REACH, _HERE, _SUBNET = "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST", "SUBNET"
_GIVEN = os.environ.get(_REACH, _HERE)
# Period of looks at who publishes what [s].
_LOOK = 0.05
# Topics that every node has.
_USUAL = {"/rosout", "/parameter_events"}


class Ros2Bus(Bus):
    """A node of ROS 2, which finds nodes of this computer alone unless its address says otherwise.

    | topic | type | QoS | has |
    |---|---|---|---|
    | `/<part>/status` | Float64MultiArray | reliable, last 10 | labels, the first `stamp` |
    | `/<part>/joint_states`, `imu`, `magnetic_field` | of sensor_msgs | ditto | where units fit |
    | `/<part>/command` | Float64MultiArray | taken as best effort, last 10 | like the status |
    | `/station/stop` | Bool | taken as transient local | true: all parts are neutral |
    | `/station/emergency_stop` | Bool | reliable, transient local | true: it is pressed |
    | `/clock` | Clock | reliable, last 10 | time of the machine |
    | `/robot_description` | String | reliable, transient local | URDF |
    | `/tf` | TFMessage | reliable, last 100 | poses of the links |

    With a namespace, all but `/clock` and `/tf` have it before their names. What is subscribed to
    may be published in another standard type whose fields fill its signals. The node is managed:
    it is configured and active from the beginning, and while it is not active all parts are
    neutral.
    """

    draws = True

    def __init__(self, address: Address, name: str = "parapod"):
        """Makes the node.

        Args:
            address: its place is the number of the domain, "" for that of the environment, and
                `?range=subnet` where other computers are to be found; its suffix is the namespace.
            name: name of the node.

        Raises:
            DeviceError: ROS 2 does not begin.
            MissingExtra: it is not installed.
        """
        rclpy = need("rclpy")
        lifecycle = need("rclpy.lifecycle")
        signals = need("rclpy.signals")
        domain, _, reach = address.place.partition("?")
        self.address = address
        self._root = f"/{address.suffix}" if address.suffix else ""
        # ROS 2 looks at it when a context begins; what another bus asked for does not count.
        os.environ[_REACH] = _SUBNET if reach else _GIVEN
        self._is_local = os.environ[_REACH] == _HERE
        self.name = f"ROS 2 {ROS2}://{domain or os.environ.get('ROS_DOMAIN_ID', '0')}"
        self._context = need("rclpy.context").Context()
        try:
            rclpy.init(
                context=self._context,
                domain_id=int(domain) if domain else None,
                signal_handler_options=signals.SignalHandlerOptions.NO,
            )
            self._node = self._managed(lifecycle)(
                name, namespace=self._root or None, context=self._context
            )
        except Exception as error:  # of a library in C, which has several
            raise DeviceError(self.name, str(error), DeviceFault.UNPLUGGED) from error
        self._publishers: dict[str, Any] = {}
        self._arrays: dict[tuple[str, tuple[str, ...]], Any] = {}
        self._views: dict[str, tuple[Layout, list[tuple[str, Mapping[str, str], Any, Any]]]] = {}
        self._inboxes: dict[str, list[Inbox]] = {}
        self._taken: dict[str, str] = {}
        self._counted: dict[str, int] = {}
        self._latches: dict[str, tuple[Any, object]] = {}
        self._is_active, self._is_stopped = False, False
        self._transforms: TransformWriter | None = None
        self._node.trigger_configure()
        self._node.trigger_activate()
        self._node.create_subscription(
            _message_type("std_msgs/msg/Bool"),
            f"{self._root}/station/stop",
            self._take_stop,
            self._latched,
        )
        self._node.create_timer(_LOOK, self._look)
        self._executor = need("rclpy.executors").SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name=self.name, daemon=True)
        self._thread.start()

    def _managed(self, lifecycle: Any) -> type[Any]:
        """The class of the node: its transitions are this bus's."""
        bus, success = self, lifecycle.TransitionCallbackReturn.SUCCESS

        class Managed(lifecycle.LifecycleNode):
            def on_activate(self, state: Any) -> Any:
                bus._is_active = True
                return success

            def on_deactivate(self, state: Any) -> Any:
                bus._is_active = False
                return success

        return Managed

    def _spin(self) -> None:
        # Closing the node ends it, by whatever error the library then has.
        with suppress(Exception):
            self._executor.spin()

    @property
    def _latched(self) -> Any:
        qos = need("rclpy.qos")
        return qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)

    @property
    def stop(self) -> str:
        """See `Bus`."""
        if self._is_stopped:
            return f"{self._root}/station/stop is true"
        return "" if self._is_active else f"the node {self._full_name} is not active"

    @property
    def _full_name(self) -> str:
        return str(self._node.get_fully_qualified_name())

    def _take_stop(self, message: Any) -> None:
        self._is_stopped = bool(message.data)

    def publish(self, channel: str, message: Message) -> None:
        """See `Bus`."""
        names = tuple(message.names)
        kept = self._arrays.get((channel, names))
        if kept is None:
            kept = self._arrays[channel, names] = self._array(names)
        if channel not in self._publishers:
            self._publishers[channel] = self._node.create_publisher(
                _message_type(ARRAY), channel, 10
            )
        kept.data = array("d", (message.stamp, *message.values))
        self._publishers[channel].publish(kept)
        if channel in self._views:
            self._publish_views(channel, message)

    def _array(self, names: Sequence[str]) -> Any:
        """An array whose labels are names."""
        one, dimension = _message_type(ARRAY)(), _message_type("std_msgs/msg/MultiArrayDimension")
        one.layout.dim = [
            dimension(label=label, size=size, stride=size) for label, size in labels_of(names)
        ]
        return one

    def advertise(self, channel: str, layout: Layout) -> None:
        """See `Bus`: standard messages of the part, beside the array."""
        beside = channel.rpartition("/")[0]
        views: list[tuple[str, Mapping[str, str], Any, Any]] = []
        for kind, signals in standard(layout).items():
            standard_message = _message_type(kind)()
            standard_message.header.frame_id = layout.part
            publisher = self._node.create_publisher(
                _message_type(kind),
                f"{beside}/{TOPICS[kind]}",
                10,
            )
            views.append((kind, signals, publisher, standard_message))
        if views:
            self._views[channel] = layout, views

    def _publish_views(self, channel: str, message: Message) -> None:
        layout, views = self._views[channel]
        with suppress(WrongMessage):  # a value that is not finite is in the array alone
            values = layout.unpack(message)
            for kind, signals, publisher, standard_message in views:
                fill(standard_message, kind, layout.part, signals, values)
                standard_message.header.stamp = self._time(message.stamp)
                publisher.publish(standard_message)

    def _time(self, time: float) -> Any:
        nanoseconds = round(1e9 * max(time, 0.0))
        kind = _message_type("builtin_interfaces/msg/Time")
        return kind(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)

    def tell(self, time: float, is_stopped: bool) -> None:
        """See `Bus`: /clock, and the emergency stop where it has changed."""
        kind = _message_type("rosgraph_msgs/msg/Clock")
        if "/clock" not in self._publishers:
            self._publishers["/clock"] = self._node.create_publisher(kind, "/clock", 10)
        self._publishers["/clock"].publish(kind(clock=self._time(time)))
        self._latch("station/emergency_stop", "std_msgs/msg/Bool", is_stopped)

    def describe(self, urdf: str) -> None:
        """See `Bus`: /robot_description; and /tf begins.

        Raises:
            MissingExtra: nothing is installed that writes /tf.
        """
        self._transforms = TransformWriter(self._node, self._is_local)
        self._latch("robot_description", "std_msgs/msg/String", urdf)

    def _latch(self, topic: str, kind: str, data: object) -> None:
        """Publishes what late subscribers get as well, where it has changed."""
        message_type = _message_type(kind)
        if topic not in self._latches:
            publisher = self._node.create_publisher(
                message_type, f"{self._root}/{topic}", self._latched
            )
            self._latches[topic] = publisher, None
        publisher, last = self._latches[topic]
        if data != last:
            publisher.publish(message_type(data=data))
            self._latches[topic] = publisher, data

    def place(self, poses: Poses, time: float) -> None:
        """See `Bus`: /tf, once the machine is described."""
        if self._transforms is not None:
            self._transforms.write(poses, time)

    def subscribe(self, inbox: Inbox) -> None:
        """See `Bus`."""
        self._inboxes.setdefault(inbox.channel, []).append(inbox)

    def _take_type(self, channel: str, kind: str) -> None:
        """Takes what is published in a type; the library has one type of a topic in a node."""
        qos = need("rclpy.qos")
        profile = qos.QoSProfile(depth=10, reliability=qos.ReliabilityPolicy.BEST_EFFORT)

        # The library looks at the number of parameters.
        def take(message: Any, info: Any) -> None:
            self._take(channel, kind, message, info)

        self._node.create_subscription(_message_type(kind), channel, take, profile)
        self._taken[channel] = kind

    def _take(self, channel: str, kind: str, message: Any, info: Mapping[str, Any]) -> None:
        """Gives what has come to the inboxes; must not raise."""
        now, number = monotonic(), info.get("publication_sequence_number") or 0
        back, self._counted[channel] = number <= self._counted.get(channel, -1), number
        for inbox in self._inboxes[channel]:
            try:
                inbox.take(values_of(kind, message, inbox.layout), now)
            except WrongMessage as error:
                inbox.refuse(str(error), now)
            if back and number:
                nodes = ", ".join(sorted(self._senders(channel)))
                inbox.refuse(f"messages of two senders, or of one anew: {nodes}", now)

    def _senders(self, channel: str) -> set[str]:
        infos = self._node.get_publishers_info_by_topic(channel)
        return {f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos}

    def _look(self) -> None:
        """Takes the type that is published, and names those that cannot be taken."""
        for channel, inboxes in list(self._inboxes.items()):
            for info in self._node.get_publishers_info_by_topic(channel):
                kind, present = info.topic_type, self._taken.get(channel)
                if kind == present:
                    continue
                possible = {ARRAY}.union(*(standard(inbox.layout) for inbox in inboxes))
                if kind in possible and present is None:
                    self._take_type(channel, kind)
                    continue
                types = present or ", ".join(sorted(possible))
                for inbox in inboxes:
                    words = f"/{info.node_name} publishes {kind}, not {types}"
                    inbox.refuse(words, monotonic())

    def channels(self) -> Sequence[str]:
        """See `Bus`."""
        own = {*self._publishers, *_USUAL}
        topics = (name for name, _ in self._node.get_topic_names_and_types())
        return sorted(
            name for name in topics if name not in own and self._senders(name) - {self._full_name}
        )

    def close(self) -> None:
        """See `Bus`."""
        with suppress(Exception):
            need("rclpy").shutdown(context=self._context)
        self._thread.join(timeout=2.0)
        if self._transforms is not None:
            self._transforms.close()
        with suppress(Exception):
            self._node.destroy_node()


@cache
def _message_type(kind: str) -> Any:
    """Class of a type such as "std_msgs/msg/Bool"."""
    package, _, name = kind.split("/")
    return getattr(need(f"{package}.msg"), name)
