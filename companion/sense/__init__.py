"""Sense: bytes and pixels to SI units. Frames to pad sightings, registers and serial bytes to samples."""
