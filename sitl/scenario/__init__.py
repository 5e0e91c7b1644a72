"""Scenarios: the definition of a flight."""
