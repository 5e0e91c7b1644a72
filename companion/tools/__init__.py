"""Tools beside the flight: pads, check, fuzzy, identify."""
