"""Lands a multirotor by vision, softly, on a pad that moves: the onboard computer's application."""
