"""Devices that are not there: the makers' protocols answered by a simulated machine."""
