"""Logs of runs: written, read again, and drawn."""
