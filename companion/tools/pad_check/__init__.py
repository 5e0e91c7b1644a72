"""`companion check`."""
