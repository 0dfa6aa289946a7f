"""ROS 2: messages by their fields, and a graph between nodes of this computer."""

import math
import os
import struct
import time
import zlib
from pathlib import Path
from types import SimpleNamespace as Fields

import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Box, Cylinder, Mesh
from pydrake.math import RigidTransform, RollPitchYaw

from parapod.systems.core.errors import ScenarioError
from parapod.systems.hardware.buses.address import ROS2, Address, address_of
from parapod.systems.hardware.buses.bus import Inbox, Visual
from parapod.systems.hardware.buses.connection import connect
from parapod.systems.hardware.buses.message import Layout, Message, Signal, WrongMessage
from parapod.systems.hardware.buses.ros2.arrays import decoded, encoded
from parapod.systems.hardware.buses.ros2.messages import (
    ARRAY,
    DRIVEN,
    FIELD,
    IMU,
    JOINTS,
    STAMPED,
    TWIST,
    admissible,
    fill,
    labels_of,
    of_array,
    standard,
    values_of,
)
from parapod.systems.hardware.buses.ros2.scene import Scene
from parapod.systems.hardware.buses.served_part import ServedPart
from parapod.systems.hardware.device import DeviceError, DeviceFault
from tests.systems.hardware.buses.conftest import until

LEGS = Layout(
    {
        "extension": Signal(2, "m"),
        "velocity": Signal(2, "m/s"),
        "limits": Signal(4, "0/1"),
        "force_command": Signal(2, "N"),
    },
    "legs",
)
SENSOR = Layout(
    {"gyro": Signal(3, "rad/s"), "accel": Signal(3, "m/s^2"), "mag": Signal(3, "T")}, "imu"
)


# Wheels of a radius of 125 mm, 200 mm to the left and to the right.
STEERING = ((8.0, -1.6), (8.0, 1.6), (8.0, 1.6), (8.0, -1.6))
TURNING = Signal(4, "rad/s", twist=STEERING)
WHEEL_COMMANDS = {"velocity_command": TURNING, "brake": Signal(1, "-", idle=1.0)}
WHEELS = Layout({"velocity": TURNING, **WHEEL_COMMANDS}, "wheels")
COMMANDS = Layout(WHEEL_COMMANDS, "wheels")


def twist(speed=0.0, rate=0.0, aside=0.0):
    return Fields(linear=Fields(x=speed, y=aside, z=0.0), angular=Fields(x=0.0, y=0.0, z=rate))


def joints(**fields):
    usual = {"name": [], "position": [], "velocity": [], "effort": []}
    stamp = Fields(sec=3, nanosec=250_000_000)
    return Fields(header=Fields(stamp=stamp), **(usual | fields))


def test_standard_messages_follow_from_the_units():
    assert standard(LEGS) == {JOINTS: {"position": "extension", "velocity": "velocity"}}
    assert standard(SENSOR) == {
        IMU: {"angular_velocity": "gyro", "linear_acceleration": "accel"},
        FIELD: {"magnetic_field": "mag"},
    }
    assert standard(Layout({"force": Signal(3, "N")}, "cells")) == {}
    assert standard(Layout({"position": Signal(2)}, "unknown")) == {}


def test_what_drives_a_machine_follows_a_twist():
    assert standard(WHEELS) == {DRIVEN: {"twist": "velocity"}}
    assert admissible(COMMANDS) == {ARRAY, TWIST, STAMPED}
    unsure = Layout({"velocity_command": TURNING, "torque": Signal(4)}, "wheels")
    assert admissible(unsure) == {ARRAY}
    message = values_of(TWIST, twist(0.3, -0.5), COMMANDS)
    signals = COMMANDS.unpack(message)
    right, left = 8.0 * 0.3 - 1.6 * 0.5, 8.0 * 0.3 + 1.6 * 0.5
    assert signals["velocity_command"] == pytest.approx((left, right, right, left))
    assert signals["brake"] == (0.0,)
    assert message.stamp == 0.0
    header = Fields(stamp=Fields(sec=3, nanosec=250_000_000))
    later = values_of(STAMPED, Fields(header=header, twist=twist(0.3, -0.5)), COMMANDS)
    assert later == message._replace(stamp=3.25)
    driven = Fields(twist=Fields(twist=twist()))
    values = {"velocity": signals["velocity_command"]}
    fill(driven, DRIVEN, WHEELS, standard(WHEELS)[DRIVEN], values)
    assert driven.twist.twist.linear.x == pytest.approx(0.3)
    assert driven.twist.twist.angular.z == pytest.approx(-0.5)


@pytest.mark.parametrize("aside", [0.1, math.nan])
def test_a_twist_that_wheels_cannot_follow_is_refused(aside):
    with pytest.raises(WrongMessage, match=r"for linear\.y, and wheels cannot follow"):
        values_of(TWIST, twist(0.3, aside=aside), COMMANDS)
    with pytest.raises(WrongMessage, match="has nan for velocity_command"):
        COMMANDS.unpack(values_of(TWIST, twist(rate=math.nan), COMMANDS))


def test_an_array_is_what_was_packed():
    names, values = LEGS.names, [0.5 * i for i in range(len(LEGS.names))]
    message = of_array(labels_of(names), [7.25, *values], LEGS)
    assert message == Message(list(names), tuple(values), 7.25)
    assert of_array([], values, LEGS) == Message(names, values, 0.0)


@pytest.mark.parametrize(
    ("labels", "values", "words"),
    [
        ([], [1.0], "has 1 values without labels, not the 10 of extension"),
        (labels_of(LEGS.names), [1.0, 2.0], "has labels of 11 values for 2"),
    ],
)
def test_arrays_that_do_not_fit_are_named(labels, values, words):
    with pytest.raises(WrongMessage, match=words):
        of_array(labels, values, LEGS)


def test_arrays_are_those_of_the_library_and_back():
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from rclpy.serialization import deserialize_message, serialize_message
    from std_msgs.msg import Float64MultiArray

    for names in (LEGS.names, SENSOR.names, ("voltage",), ("grösse", "a", "ab", "abc[0]"), ()):
        values = tuple(0.1 * i for i in range(len(names)))
        data = encoded(names, 2.5, values)
        message = deserialize_message(data, Float64MultiArray)
        assert [(d.label, d.size) for d in message.layout.dim] == labels_of(names)
        assert list(message.data) == [2.5, *values]
        theirs = serialize_message(message)  # whose padding may hold anything
        assert len(theirs) == len(data)
        assert decoded(theirs) == decoded(data) == (labels_of(names), (2.5, *values))
    plain = serialize_message(Float64MultiArray(data=[3.0, 4.0]))
    assert decoded(plain) == ([], (3.0, 4.0))
    assert decoded(serialize_message(Float64MultiArray())) == ([], ())


def test_bytes_that_are_no_array_are_refused_wherever_they_are_damaged():
    data = encoded(("position[0]", "brake"), 2.0, (1.0, 0.0))
    for end in range(len(data)):
        with pytest.raises(WrongMessage, match="is not a Float64MultiArray"):
            decoded(data[:end])
    for at in (0, 1, 7, 11):  # kind of bytes, number of labels, length of the first
        damaged = bytearray(data)
        damaged[at] ^= 0x55
        with pytest.raises(WrongMessage, match="is not a Float64MultiArray"):
            decoded(bytes(damaged))


def test_arrays_of_computers_of_the_other_order_of_bytes_are_read():
    body = struct.pack(">I", 1) + struct.pack(">I", 2) + b"a\0\0\0"
    body += struct.pack(">IIII", 2, 2, 0, 2) + bytes(4) + struct.pack(">2d", 1.5, -2.5)
    assert decoded(b"\0\0\0\0" + body) == ([("a", 2)], (1.5, -2.5))


def test_joints_are_known_by_their_names_or_their_order():
    wanted = Layout({"extension": Signal(2, "m")}, "legs")
    named = joints(name=["wheel", "legs_2", "legs_1"], position=[9.0, 2.0, 1.0])
    assert values_of(JOINTS, named, wanted).values == [1.0, 2.0]
    assert values_of(JOINTS, named, wanted).stamp == 3.25
    other = joints(name=["left", "right"], position=[4.0, 5.0])
    assert values_of(JOINTS, other, wanted).values == [4.0, 5.0]
    with pytest.raises(WrongMessage, match="has the joints a, not legs_1, legs_2"):
        values_of(JOINTS, joints(name=["a"], position=[1.0]), wanted)
    with pytest.raises(WrongMessage, match="has 2 names of joints for 1 of position"):
        values_of(JOINTS, joints(name=["a", "b"], position=[1.0]), wanted)


def test_what_fills_a_standard_message_is_read_from_it():
    signals = {"gyro": (0.1, 0.2, 0.3), "accel": (1.0, 2.0, 9.8), "mag": (1e-5, 0.0, 2e-5)}
    for kind, fields in standard(SENSOR).items():
        message = joints(**{field: Fields() for field in fields}, orientation_covariance=[0.0] * 9)
        fill(message, kind, "imu", fields, signals)
        own = Layout({n: SENSOR.signals[n] for n in fields.values()}, "imu")
        assert own.unpack(values_of(kind, message, own)) == {
            n: signals[n] for n in fields.values()
        }


@pytest.mark.parametrize(
    "text", ["ros2://233", "ros2://x", "ros2://1?range=all", "ros2://1#left-arm", "ros2://#/x"]
)
def test_addresses_that_ros_2_does_not_have_are_refused_in_a_line(text):
    with pytest.raises(ScenarioError) as caught:
        address_of(text, "bus")
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_topics_have_the_namespace():
    assert address_of("ros2://7#left", "bus").channels_of("legs") == (
        "/left/legs/status",
        "/left/legs/command",
    )
    renamed = Address(ROS2, status="/joint_states")
    assert renamed.channels_of("legs") == ("/joint_states", "/legs/command")


# A graph of nodes


@pytest.fixture
def graph():
    """Address of a graph that no other test has; skips where ROS 2 is not installed."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    number = zlib.crc32(f"{os.getpid()} {time.time_ns()}".encode())
    return Address(ROS2, str(1 + number % 100), f"test_{number:08x}")


@pytest.fixture
def buses(graph):
    both = connect(graph, "one"), connect(graph, "other")
    yield both
    for bus in both:
        bus.close()


def heard(sender, inbox, message, channel="/legs/status"):
    """Whether a message has come, which is sent until it has."""

    def come():
        sender.publish(channel, message())
        time.sleep(5e-3)
        return inbox.newest

    until(come, 60.0)
    return inbox.newest


def stamps():
    """Messages of the legs, each later than the one before."""
    begun = time.monotonic()
    return lambda: Message(LEGS.names, [0.25] * len(LEGS.names), 1.0 + time.monotonic() - begun)


def test_an_array_comes_as_it_was_sent(graph, buses):
    one, other = buses
    channel = graph.channels_of("legs").status
    inbox = Inbox(channel, LEGS, math.inf, 1.0)
    other.subscribe(inbox)
    received = heard(one, inbox, stamps(), channel)
    assert received.signals == {n: (0.25,) * each.size for n, each in LEGS.signals.items()}
    assert channel in other.channels()
    assert channel not in one.channels()


def test_joint_states_of_another_node_are_taken_and_other_types_are_named(graph, buses):
    one, other = buses
    channels = graph.channels_of("legs")
    one.advertise(channels.status, LEGS)
    beside = channels.status.replace("status", "joint_states")
    wanted = Layout({n: LEGS.signals[n] for n in ("extension", "velocity")}, "legs")
    fitting, sensor = Inbox(beside, wanted, math.inf, 60.0), Inbox(beside, SENSOR, math.inf, 60.0)
    other.subscribe(fitting)
    received = heard(one, fitting, stamps(), channels.status)
    assert received.signals == {"extension": (0.25, 0.25), "velocity": (0.25, 0.25)}
    third = connect(graph, "third")
    third.subscribe(sensor)
    try:
        until(lambda: "/one" in sensor.problem(time.monotonic()).words, 60.0)
        fault, words = sensor.problem(time.monotonic())
        assert fault is DeviceFault.CORRUPT
        assert f"/one publishes {JOINTS}, not {IMU}, {FIELD}, {ARRAY}" in words
    finally:
        third.close()


def test_wheels_follow_the_twist_of_another_node_and_brake_when_it_is_silent(graph, buses):
    from geometry_msgs.msg import Twist, TwistWithCovarianceStamped

    one, other = buses
    wheels = ServedPart("wheels", other, {"velocity": TURNING}, WHEEL_COMMANDS)
    assert wheels.commands(time.monotonic())["brake"] == (1.0,)
    channel = graph.channels_of("wheels").command
    publisher = one._node.create_publisher(Twist, channel, 10)
    message, taken, shown = Twist(), {}, []
    message.linear.x = 0.25

    def driven():
        publisher.publish(message)
        time.sleep(5e-3)
        taken.update(wheels.commands(time.monotonic()))
        return not wheels.is_neutral

    until(driven, 60.0)
    assert taken == {"velocity_command": (2.0,) * 4, "brake": (0.0,)}
    beside = channel.replace("command", "twist")
    one._node.create_subscription(TwistWithCovarianceStamped, beside, shown.append, 10)

    def seen():
        wheels.publish({"velocity": (4.0,) * 4, **taken}, 1.0 + time.monotonic())
        time.sleep(5e-3)
        return shown

    until(seen, 60.0)
    assert shown[0].twist.twist.linear.x == pytest.approx(0.5)
    until(lambda: wheels.commands(time.monotonic()) == wheels.idle, 60.0)
    assert wheels.latched.words.startswith(f"no message on {channel} for")


def test_messages_come_while_the_time_of_devices_stands(buses, monkeypatch):
    monkeypatch.setattr("parapod.systems.hardware.buses.ros2.bus.monotonic", lambda: 5.0)
    one, other = buses
    inbox = Inbox("/legs/status", LEGS, math.inf, 60.0)
    other.subscribe(inbox)
    assert heard(one, inbox, stamps()).arrived == 5.0


def test_two_senders_of_commands_are_named(graph, buses):
    one, other = buses
    commands = Layout({"voltage": Signal(1)}, "legs")
    channel = graph.channels_of("legs").command
    third = connect(graph, "third")
    inbox = Inbox(channel, commands, math.inf, 60.0)
    third.subscribe(inbox)

    def told():
        for bus in (one, other):  # as programs that tell no time
            bus.publish(channel, Message(commands.names, (1.0,), 0.0))
        time.sleep(5e-3)
        problem = inbox.problem(time.monotonic())
        return problem is not None and all(f"/{n}" in problem.words for n in ("one", "other"))

    try:
        until(told, 60.0)
        fault, words = inbox.problem(time.monotonic())
        assert fault is DeviceFault.CORRUPT
        assert "two senders" in words
    finally:
        third.close()


def test_one_that_asks_for_other_computers_does_not_take_the_next_one_along(graph, monkeypatch):
    from parapod.systems.hardware.buses.ros2 import bus as module

    reaches = []
    monkeypatch.setattr(module, "_GIVEN", "LOCALHOST")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

    def begin(**_):
        reaches.append(os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"])
        raise RuntimeError("not here")

    monkeypatch.setattr("rclpy.init", begin)
    for place in (f"{graph.place}?range=subnet", graph.place):
        with pytest.raises(DeviceError):  # what ROS 2 is told is enough
            connect(graph._replace(place=place))
    assert reaches == ["SUBNET", "LOCALHOST"]


def test_a_stop_reaches_nodes_that_come_later(graph, buses):
    from std_msgs.msg import Bool

    one, other = buses
    assert one.stop == other.stop == ""
    topic = f"/{graph.suffix}/station/stop"
    publisher = one._node.create_publisher(Bool, topic, one._latched)
    publisher.publish(Bool(data=True))
    until(lambda: other.stop, 60.0)
    late = connect(graph, "late")
    try:
        until(lambda: late.stop, 60.0)
        assert late.stop == f"{topic} is true"
        publisher.publish(Bool(data=False))
        until(lambda: not late.stop and not other.stop, 60.0)
    finally:
        late.close()


def test_a_node_that_is_not_active_stops_its_parts(buses, graph):
    one, _ = buses
    one._node.trigger_deactivate()
    assert one.stop == f"the node /{graph.suffix}/one is not active"
    one._node.trigger_activate()
    assert one.stop == ""


def _bodies():
    """A box on a body with another, and a mesh on a second."""
    half = RigidTransform(RollPitchYaw(0.3, -0.2, 0.1), [0.0, 0.1, 0.5])
    red, pale = (1.0, 0.0, 0.0, 1.0), (0.5, 0.5, 0.5, 0.25)
    return {
        "leg/upper": [
            Visual(Box(0.1, 0.2, 0.3), half, red),
            Visual(Cylinder(0.1, 0.4), RigidTransform(), pale),
        ],
        "seat": [Visual(Mesh("seat.obj", 2.0), RigidTransform([1.0, 0.0, 0.0]), pale)],
    }


def _some_poses(angle):
    """Poses of the bodies, and as those of Drake."""
    one = RigidTransform(RollPitchYaw(angle, 0.5, -0.4), [1.0, 2.0, 3.0])
    other = RigidTransform(RollPitchYaw(0.1, angle, 0.7), [-1.0, 0.0, 4.0])
    drake = {"leg/upper": one, "seat": other}
    return drake, {
        name: (pose.translation(), pose.rotation().ToQuaternion().wxyz())
        for name, pose in drake.items()
    }


def _pose_of(position, turn):
    quaternion = Quaternion([turn.w, turn.x, turn.y, turn.z])
    return RigidTransform(quaternion, [position.x, position.y, position.z])


def test_a_machine_is_on_the_graph_as_markers_in_the_world(buses, graph):
    messages = pytest.importorskip("visualization_msgs.msg", reason="ROS 2 is not installed")
    one, other = buses
    bodies = _bodies()
    one.describe("<robot name='x'/>", bodies)
    assert not one.is_watched
    seen = []
    topic = f"/{graph.suffix}/scene"
    other._node.create_subscription(messages.MarkerArray, topic, seen.append, 10)
    until(lambda: one.is_watched, 60.0)
    for time_of, angle in ((5.25, 0.2), (6.0, -1.0)):
        seen.clear()
        drake, poses = _some_poses(angle)
        one.place(poses, time_of)
        until(lambda: seen, 60.0)
        solids = [(name, each) for name, body in bodies.items() for each in body]
        assert len(seen[0].markers) == len(solids)
        for marker, (name, solid) in zip(seen[0].markers, solids, strict=True):
            assert (marker.header.frame_id, marker.ns) == ("world", name)
            stamp = marker.header.stamp
            assert stamp.sec + 1e-9 * stamp.nanosec == time_of
            there = _pose_of(marker.pose.position, marker.pose.orientation)
            assert there.IsNearlyEqualTo(drake[name] @ solid.pose, 1e-12)
            assert (marker.color.r, marker.color.a) == (solid.colour[0], solid.colour[3])
    box, cylinder, mesh = seen[0].markers
    assert (box.type, box.scale.x, box.scale.z) == (box.CUBE, 0.1, 0.3)
    assert (cylinder.type, cylinder.scale.x, cylinder.scale.z) == (box.CYLINDER, 0.2, 0.4)
    assert (mesh.type, mesh.scale.y) == (box.MESH_RESOURCE, 2.0)
    assert mesh.mesh_resource == (Path.cwd() / "seat.obj").as_uri()
    topics = dict(other._node.get_topic_names_and_types())
    assert topics[f"/{graph.suffix}/robot_description"] == ["std_msgs/msg/String"]


def test_a_machine_without_solids_is_described_and_never_watched(buses):
    one, _ = buses
    one.describe("<robot name='x'/>", {})
    assert not one.is_watched
    one.place({}, 1.0)


def test_transforms_of_the_bodies_are_beside_the_markers():
    kind, library = "tf2_msgs/msg/TFMessage", pytest.importorskip("rosbags.typesys")
    store = library.get_typestore(library.Stores.ROS2_HUMBLE)

    def made(kind, **fields):
        # Markers are tried on the graph: here they need no more than times and poses.
        return Fields(**fields) if "visualization" in kind else store.types[kind](**fields)

    def serialized(message):
        if not isinstance(message, Fields):
            return bytes(store.serialize_cdr(message, kind))
        headers = [
            struct.pack("=iI", m.header.stamp.sec, m.header.stamp.nanosec) for m in message.markers
        ]
        places = [(m.pose.position, m.pose.orientation) for m in message.markers]
        return b"".join(headers) + b"".join(
            struct.pack("=7d", p.x, p.y, p.z, q.x, q.y, q.z, q.w) for p, q in places
        )

    scene = Scene(made, serialized, _bodies(), True)
    for angle in (0.2, -1.0):
        drake, poses = _some_poses(angle)
        message = store.deserialize_cdr(scene.at(poses, 5_250_000_000)[kind], kind)
        assert [each.child_frame_id for each in message.transforms] == list(drake)
        for each in message.transforms:
            assert (each.header.frame_id, each.header.stamp.sec) == ("world", 5)
            there = _pose_of(each.transform.translation, each.transform.rotation)
            assert there.IsNearlyEqualTo(drake[each.child_frame_id], 1e-12)
