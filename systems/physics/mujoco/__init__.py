"""Rigid bodies of a Drake plant, translated for MuJoCo and stepped by it."""
