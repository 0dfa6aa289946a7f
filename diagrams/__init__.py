"""Wiring only: typed scenarios, stations, controllers and closed loops made of parapod.systems."""
