"""Lands a multirotor by vision, softly, on a pad that moves: the onboard computer's application."""

# the one place that states it: pyproject.toml reads it here
__version__ = "0.2.0"
