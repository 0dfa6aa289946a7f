"""Experiments, the scenarios they run, their results, and the `parapod` command."""
