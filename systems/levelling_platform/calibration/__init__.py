"""Calibration of the levelling platform from poses in which it stood still."""
