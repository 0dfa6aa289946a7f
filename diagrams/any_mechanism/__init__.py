"""Machines made of a model file: any closed-loop mechanism, its drives, its diagrams."""
