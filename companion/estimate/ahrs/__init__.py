"""Orientation without position: alignment, Madgwick and complementary filter."""
