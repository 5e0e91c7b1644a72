"""Replay: the estimators run again over a recorded flight, and are held against what was recorded."""
