"""`companion identify`: a flight in, the flight model's numbers and their lines for the settings out."""
