"""Physics engines beside Drake's own."""
