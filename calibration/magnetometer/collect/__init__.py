"""Collects samples live and guides the rotation."""
