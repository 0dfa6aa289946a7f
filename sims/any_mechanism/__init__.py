"""Mechanisms of model files: any closed-loop machine, its drives, its workspace."""
