"""`calibrate-camera`."""
