"""Scenarios: what a flight is to be like."""
