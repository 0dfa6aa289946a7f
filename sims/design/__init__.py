"""Search for designs of a machine: entries of its data sheet, and metrics of experiments."""
