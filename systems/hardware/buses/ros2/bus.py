"""ROS 2 by its own library: a managed node whose topics are the channels of parts."""

import itertools
import os
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from importlib.util import find_spec
from time import sleep
from typing import Any

from parapod.systems.core.extras import need
from parapod.systems.hardware.buses.address import ROS2, SUBNET, Address
from parapod.systems.hardware.buses.bus import Bus, Poses, Visual
from parapod.systems.hardware.buses.message import Layout, Message, WrongMessage
from parapod.systems.hardware.buses.ros2.arrays import decoded, encoded
from parapod.systems.hardware.buses.ros2.messages import (
    ARRAY,
    TOPICS,
    admissible,
    fill,
    of_array,
    standard,
    values_of,
)
from parapod.systems.hardware.buses.ros2.scene import MARKERS, TRANSFORMS, Scene
from parapod.systems.hardware.clock import monotonic
from parapod.systems.hardware.device import DeviceError, DeviceFault

# Key of the environment that says how far ROS 2 looks for other nodes, and what the user's said.
_REACH, _HERE, _SUBNET = "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST", "SUBNET"
_GIVEN = os.environ.get(_REACH, _HERE)
# Period of looks at what has come [s], and of those at who publishes what and at requests, by it.
_LOOK, _SELDOM = 1e-3, 50
# Topics that every node has.
_USUAL = {"/rosout", "/parameter_events"}


class Ros2Bus(Bus):
    """A node of ROS 2, which finds nodes of this computer alone unless its address says otherwise.

    | topic | type | QoS | has |
    |---|---|---|---|
    | `/<part>/status` | Float64MultiArray | reliable, last 10 | labels, the first `stamp` |
    | `/<part>/joint_states`, `imu`, `magnetic_field` | of sensor_msgs | ditto | where units fit |
    | `/<part>/twist` | TwistWithCovarianceStamped | ditto | of a part that drives the machine |
    | `/<part>/command` | Float64MultiArray | taken as best effort, last 10 | like the status |
    | `/station/stop` | Bool | taken as transient local | true: all parts are neutral |
    | `/station/emergency_stop` | Bool | reliable, transient local | true: it is pressed |
    | `/clock` | Clock | reliable, last 10 | time of the machine |
    | `/scene` | MarkerArray | reliable, transient local | the machine in the frame `world` |
    | `/robot_description` | String | ditto | URDF |
    | `/tf` | TFMessage | reliable, last 100 | poses of its links, where the type is installed |

    With a namespace, all but `/clock` and `/tf` have it before their names. What is subscribed to
    may be published in another standard type whose fields fill its signals. The node is managed:
    it is configured and active from the beginning, and while it is not active all parts are
    neutral.

    A thread looks for messages every millisecond. The library's executors, which wait for them,
    need three times as long for each.
    """

    draws = True

    def __init__(self, address: Address, name: str = "parapod"):
        """Makes the node.

        Args:
            address: its place is the number of the domain, "" for that of the environment, and
                after ? the option `SUBNET`; its suffix is the namespace.
            name: name of the node.

        Raises:
            DeviceError: ROS 2 does not begin.
            MissingExtra: it is not installed.
        """
        rclpy = need("rclpy")
        lifecycle = need("rclpy.lifecycle")
        signals = need("rclpy.signals")
        domain, _, option = address.place.partition("?")
        super().__init__(address)
        self._root = f"/{address.suffix}" if address.suffix else ""
        # ROS 2 looks at it when a context begins; what another bus asked for does not count.
        os.environ[_REACH] = _SUBNET if option == SUBNET else _GIVEN
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
        serialization = need("rclpy.serialization")
        self._serialized = serialization.serialize_message
        self._deserialized = serialization.deserialize_message
        self._publishers: dict[str, Any] = {}
        self._views: dict[str, tuple[Layout, list[tuple[str, Mapping[str, str], Any, Any]]]] = {}
        self._subscriptions: dict[str, tuple[str, Any]] = {}
        self._counted: dict[str, int] = {}
        self._latches: dict[str, object] = {}
        self._making = threading.Lock()
        self._is_active, self._is_stopped = False, False
        self._scene: Scene | None = None
        self._drawing: dict[str, Any] = {}
        self._node.trigger_configure()
        self._node.trigger_activate()
        self._stopping = f"{self._root}/station/stop"
        self._polled = self._never()
        self._subscribe(self._stopping, "std_msgs/msg/Bool", self._latched)
        self._executor = need("rclpy.executors").SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._over = False
        self._thread = threading.Thread(target=self._receive, name=self.name, daemon=True)
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

    def _never(self) -> Any:
        """A group whose subscriptions no executor looks at."""

        class Never(need("rclpy.callback_groups").CallbackGroup):  # type: ignore[misc]
            def can_execute(self, entity: Any) -> bool:
                return False

            def beginning_execution(self, entity: Any) -> bool:
                return False

        return Never()

    def _receive(self) -> None:
        looks = itertools.count()
        while not self._over:
            sleep(_LOOK)
            for channel, (kind, subscription) in list(self._subscriptions.items()):
                while True:
                    with subscription.handle:
                        came = subscription.handle.take_message(subscription.msg_type, True)
                    if came is None:
                        break
                    self._take(channel, kind, *came)
            if next(looks) % _SELDOM == 0:
                self._executor.spin_once(timeout_sec=0.0)
                self._look()

    @property
    def _latched(self) -> Any:
        qos = need("rclpy.qos")
        return qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)

    @property
    def _unreliable(self) -> Any:
        qos = need("rclpy.qos")
        return qos.QoSProfile(depth=10, reliability=qos.ReliabilityPolicy.BEST_EFFORT)

    @property
    def stop(self) -> str:
        """See `Bus`."""
        if self._is_stopped:
            return f"{self._stopping} is true"
        return "" if self._is_active else f"the node {self._full_name} is not active"

    @property
    def _full_name(self) -> str:
        return str(self._node.get_fully_qualified_name())

    def publish(self, channel: str, message: Message) -> None:
        """See `Bus`."""
        data = encoded(message.names, message.stamp, message.values)
        self._publisher(ARRAY, channel).publish(data)
        if channel in self._views:
            self._publish_views(channel, message)

    def _publisher(self, kind: str, topic: str, qos: Any = 10) -> Any:
        """The publisher of a topic, of which the node has one; the library makes one at a time."""
        if topic not in self._publishers:
            with self._making:
                self._publishers[topic] = self._node.create_publisher(
                    _message_type(kind), topic, qos
                )
        return self._publishers[topic]

    def advertise(self, channel: str, layout: Layout) -> None:
        """See `Bus`: standard messages of the part, beside the array."""
        beside = channel.rpartition("/")[0]
        views: list[tuple[str, Mapping[str, str], Any, Any]] = []
        for kind, signals in standard(layout).items():
            standard_message = _message_type(kind)()
            standard_message.header.frame_id = layout.part
            publisher = self._publisher(kind, f"{beside}/{TOPICS[kind]}")
            views.append((kind, signals, publisher, standard_message))
        if views:
            self._views[channel] = layout, views

    def also(self, layout: Layout) -> Sequence[str]:
        """See `Bus`."""
        return sorted(admissible(layout) - {ARRAY})

    def _publish_views(self, channel: str, message: Message) -> None:
        layout, views = self._views[channel]
        views = [view for view in views if view[2].get_subscription_count()]
        if not views:
            return
        with suppress(WrongMessage):  # a value that is not finite is in the array alone
            values = layout.unpack(message)
            for kind, signals, publisher, standard_message in views:
                fill(standard_message, kind, layout, signals, values)
                standard_message.header.stamp = self._time(message.stamp)
                publisher.publish(standard_message)

    def _time(self, time: float) -> Any:
        nanoseconds = round(1e9 * max(time, 0.0))
        kind = _message_type("builtin_interfaces/msg/Time")
        return kind(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)

    def tell(self, time: float, is_stopped: bool) -> None:
        """See `Bus`: /clock, and the emergency stop where it has changed."""
        kind = "rosgraph_msgs/msg/Clock"
        self._publisher(kind, "/clock").publish(_message_type(kind)(clock=self._time(time)))
        self._latch("station/emergency_stop", "std_msgs/msg/Bool", is_stopped)

    def describe(self, urdf: str, visuals: Mapping[str, Sequence[Visual]]) -> None:
        """See `Bus`: /robot_description; /scene and /tf begin.

        Raises:
            MissingExtra: visualization_msgs is not installed.
            ParapodError: a shape that no marker draws.
        """
        self._latch("robot_description", "std_msgs/msg/String", urdf)
        if not visuals:
            return
        # It is not among the packages of ROS 2 on PyPI.
        has_transforms = find_spec("tf2_msgs") is not None
        self._scene = Scene(_made, self._serialized, visuals, has_transforms)
        scene = self._publisher(MARKERS, f"{self._root}/scene", self._latched)
        self._drawing = {MARKERS: scene}
        if has_transforms:
            self._drawing[TRANSFORMS] = self._publisher(TRANSFORMS, "/tf", 100)

    @property
    def is_watched(self) -> bool:
        """See `Bus`."""
        return any(each.get_subscription_count() for each in self._drawing.values())

    def _latch(self, topic: str, kind: str, data: object) -> None:
        """Publishes what late subscribers get as well, where it has changed."""
        if data != self._latches.get(topic):
            publisher = self._publisher(kind, f"{self._root}/{topic}", self._latched)
            publisher.publish(_message_type(kind)(data=data))
            self._latches[topic] = data

    def place(self, poses: Poses, time: float) -> None:
        """See `Bus`: /scene and /tf, once the machine is described."""
        if self._scene is not None:
            for kind, data in self._scene.at(poses, round(1e9 * max(time, 0.0))).items():
                self._drawing[kind].publish(data)

    def _listen(self, channel: str) -> None:
        """See `Bus`: the next look takes the type that is published."""

    def _subscribe(self, topic: str, kind: str, qos: Any) -> None:
        """Takes what is published; the library has one type of a topic in a node."""
        with self._making:
            subscription = self._node.create_subscription(
                *(_message_type(kind), topic, lambda _: None, qos),
                callback_group=self._polled,
                raw=True,
            )
        self._subscriptions[topic] = kind, subscription

    def _take(self, channel: str, kind: str, data: bytes, info: Mapping[str, Any]) -> None:
        """Gives what has come to the inboxes; must not raise."""
        if channel == self._stopping:
            self._is_stopped = bool(self._deserialized(data, _message_type(kind)).data)
            return
        now, number = monotonic(), info.get("publication_sequence_number") or 0
        back, self._counted[channel] = number <= self._counted.get(channel, -1), number
        inboxes = self._inboxes[channel]
        try:
            read = (
                partial(of_array, *decoded(data))
                if kind == ARRAY
                else partial(values_of, kind, self._deserialized(data, _message_type(kind)))
            )
        except WrongMessage as error:
            for inbox in inboxes:
                inbox.refuse(str(error), now)
            return
        for inbox in inboxes:
            try:
                inbox.take(read(inbox.layout), now)
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
                kind, present = info.topic_type, self._subscriptions.get(channel, ("",))[0]
                if kind == present:
                    continue
                possible = set[str]().union(*(admissible(inbox.layout) for inbox in inboxes))
                if kind in possible and not present:
                    self._subscribe(channel, kind, self._unreliable)
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

    def _end(self) -> None:
        """See `Bus`."""
        self._over = True
        self._thread.join()
        with suppress(Exception):
            self._executor.shutdown()
            self._node.destroy_node()
            need("rclpy").shutdown(context=self._context)


@cache
def _message_type(kind: str) -> Any:
    """Class of a type such as "std_msgs/msg/Bool"."""
    package, _, name = kind.split("/")
    return getattr(need(f"{package}.msg"), name)


def _made(kind: str, **fields: Any) -> Any:
    """A message of a type, of which fields that are not given have their usual values."""
    return _message_type(kind)(**fields)
