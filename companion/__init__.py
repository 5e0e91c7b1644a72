"""Lands a multirotor by vision, softly, on a pad that moves: the onboard computer's application."""

from typing import Final

# the one place that states it: pyproject.toml and the release read it here
__version__: Final = "0.2.0"
