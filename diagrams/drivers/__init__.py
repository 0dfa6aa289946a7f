"""Drivers: what a scenario names to say which device reads and drives which part of a machine.

The defaults of parapod's own are the devices of `parapod emulate`.
"""
