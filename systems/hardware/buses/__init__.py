"""Buses that other programs speak, LCM and ROS 2, with the table of ports as their messages."""
