"""Sensor models and estimators, shared by the machines."""
