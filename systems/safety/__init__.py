"""Faults of signals, and how grave they are for a machine."""
