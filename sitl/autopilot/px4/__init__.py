"""PX4's profile."""
