"""The NEO-6M: serial bytes to fixes."""
