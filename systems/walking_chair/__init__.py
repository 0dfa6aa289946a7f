"""The walking chair: a seat carried by four 2-UPS+UP legs that trots with flat feet.

Source of the equations: L. Sang, H. Wang, H. Yu, L. Vladareanu, "A novel human-carrying quadruped
walking robot", International Journal of Advanced Robotic Systems, July-August 2017, 1-17.
"Eq. (n)" in this package refers to that paper.
"""
