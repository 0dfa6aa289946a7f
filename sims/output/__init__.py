"""Output of runs: figures, metrics, progress, files and logs."""
