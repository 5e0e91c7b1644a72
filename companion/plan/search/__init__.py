"""The search for a pad that is not in view."""
