"""Measurements of speed and of accuracy over many runs; `make bench` runs them all."""
