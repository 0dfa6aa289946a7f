"""The terrain simulator: a plate that moves under one leg as the ground moves under a robot.

Source of the equations: Y. Gao, V. Barasuol, D. G. Caldwell, C. Semini, "Kinematic design of a
configurable terrain simulator platform for robotic legs". "Eq. (n)" in this package refers to that
paper.
"""
