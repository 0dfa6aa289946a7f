"""Drivers: what a scenario names to say which device reads and drives which part of a machine.

A driver is a device's settings with a tag. Defaults that are a machine's own lie with the machine,
in drivers derived from these.
"""
