"""Checks before a first flight, of a vehicle that is held by hand."""
