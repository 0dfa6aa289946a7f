"""Pendula: a package that is none of parapod's."""
