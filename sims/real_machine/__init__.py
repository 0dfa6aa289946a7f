"""Real machines: the loop in real time, the emulator, jobs on hardware."""
