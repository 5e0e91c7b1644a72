"""Minimum-jerk trajectories and the references made of them."""
