"""How the pad moves."""
