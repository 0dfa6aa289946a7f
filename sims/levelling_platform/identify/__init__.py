"""The levelling platform: identification of its actuators from voltage steps."""
