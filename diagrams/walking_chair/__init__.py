"""The walking chair as diagrams: stations, controller, closed loop."""
