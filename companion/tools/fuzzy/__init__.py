"""`companion fuzzy`."""
