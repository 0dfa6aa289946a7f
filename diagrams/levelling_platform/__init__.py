"""Wiring of the levelling platform: scenario, station, controller, closed loop."""
