"""The walking chair's chapter of the report."""
