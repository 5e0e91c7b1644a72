"""Faults as data, and their injection."""
