"""Replay: logs of simulated and real machines, drawn and plotted."""
