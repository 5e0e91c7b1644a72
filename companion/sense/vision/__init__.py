"""Pixels to the pad's pose: ArUco markers, corners, pose and its covariance."""
