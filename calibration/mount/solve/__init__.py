"""Samples in, camera-IMU extrinsics and time offset out."""
