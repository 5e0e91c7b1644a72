"""Lands a multirotor by eye, softly, on a pad that moves: the onboard computer's application."""
