"""Approach, descent and touchdown."""
