"""The laboratory: everything that experiments of all machines share."""
