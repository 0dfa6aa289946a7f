"""Level the platform over ROS 2: a node of its own, with nothing of parapod's.

    parapod serve level --ros2       # in one terminal
    python level_ros2.py             # in another

The controller is that of `level_lcm.py`. Nodes of this computer alone find it, unless the
environment says otherwise.
"""

import os

import rclpy
from leveller import Leveller
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

LABELS = {"stamp": 1, "voltage": 4, "stop": 1, "active": 1}
ESTIMATES = {"stamp": 1, "attitude_estimated": 2}


def array(labels):
    """A message whose values have labels."""
    message = Float64MultiArray()
    message.layout.dim = [
        MultiArrayDimension(label=label, size=size, stride=size) for label, size in labels.items()
    ]
    return message


def main():
    """Answers every instant of the station's with voltages, until Ctrl-C."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init()
    node, leveller, newest = rclpy.create_node("leveller"), Leveller(), {}
    commands = node.create_publisher(Float64MultiArray, "/legs/command", 10)
    estimates = node.create_publisher(Float64MultiArray, "/controller/status", 10)
    command, estimate = array(LABELS), array(ESTIMATES)

    def take_legs(joints):
        newest["legs"] = list(joints.position)

    def take_imu(imu):
        a = imu.linear_acceleration
        newest["imu"] = [a.x, a.y, a.z]

    def answer(station):
        if len(newest) == 2:
            voltages = leveller.voltages(newest["legs"], newest["imu"])
            command.data = [station.data[0], *voltages, 0.0, 1.0]
            commands.publish(command)
            # By which RViz shows the machine; a levelling controller needs none of it.
            estimate.data = [station.data[0], *leveller.inclination]
            estimates.publish(estimate)

    node.create_subscription(JointState, "/legs/joint_states", take_legs, qos_profile_sensor_data)
    node.create_subscription(Imu, "/imu/imu", take_imu, qos_profile_sensor_data)
    # The last message of an instant.
    node.create_subscription(Float64MultiArray, "/station/status", answer, qos_profile_sensor_data)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
