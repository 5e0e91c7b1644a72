"""Flights against the simulator."""
