"""The speed of approach and descent: fuzzy rules and their alternatives."""
