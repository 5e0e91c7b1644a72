"""Modes, arming, failsafes, missions: what both autopilots have around the cascade."""
