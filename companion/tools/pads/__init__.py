"""`companion pad`."""
