"""The ground that machines stand on."""
