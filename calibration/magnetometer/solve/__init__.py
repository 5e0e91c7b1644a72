"""Samples in, a judged calibration out."""
