"""Actuator plants and the controllers of single actuators, shared by the machines."""
