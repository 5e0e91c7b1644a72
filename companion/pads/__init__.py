"""Pads: printed at their true size, and judged for a camera before they are printed."""
