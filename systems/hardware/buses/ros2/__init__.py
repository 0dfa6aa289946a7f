"""ROS 2 as a bus: a node, its messages, and the transforms that show a machine."""
