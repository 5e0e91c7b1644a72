"""The simulated camera: rendering, exposure, and the way of its frames."""
