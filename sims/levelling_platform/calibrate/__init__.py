"""The levelling platform: calibration from poses, simulated, led, or of a file."""
