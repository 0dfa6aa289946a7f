"""Vectors, batching, errors and the reading of ports: the ground that all systems stand on."""
