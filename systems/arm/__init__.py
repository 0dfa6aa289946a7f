"""Arms on a machine: serial chains, a flexible rod, shaping of their commands."""
