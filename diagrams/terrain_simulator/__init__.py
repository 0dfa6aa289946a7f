"""The terrain simulator as a Drake model."""
