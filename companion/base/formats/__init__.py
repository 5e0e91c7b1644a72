"""Byte formats and streams that the app, the simulator and the tools share."""
