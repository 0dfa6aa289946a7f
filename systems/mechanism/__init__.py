"""Closed-loop mechanisms from model files: kinematics, forces, and the systems of them."""
