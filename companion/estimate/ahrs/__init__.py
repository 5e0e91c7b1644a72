"""Orientation without position: alignment, Madgwick and complementary filters."""
