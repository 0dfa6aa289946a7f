"""The 3-RPS platform: a machine of parapod from a package of its own."""
