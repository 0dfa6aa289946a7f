"""Studies: one experiment over grounds, seeds and tolerances, on all cores or on a cluster."""
