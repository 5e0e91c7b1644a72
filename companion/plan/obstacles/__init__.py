"""Obstacles and the way round them."""
