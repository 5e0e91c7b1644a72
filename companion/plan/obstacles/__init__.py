"""Obstacles and the paths around them."""
