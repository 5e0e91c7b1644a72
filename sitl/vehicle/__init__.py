"""The airframe and its motors."""
