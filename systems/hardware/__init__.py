"""Real parts: device classes that know nothing of Drake, and the systems that read and drive them.

Importing anything here needs no driver library: each device imports its own when it is configured
(`parapod.systems.hardware.device`).
"""
