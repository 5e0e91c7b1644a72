"""The flight log, the result and the report of a flight."""
