"""Corners in, intrinsics out: bundle adjustment, uncertainty and the acceptance test."""
