"""Camera sources: frames with the time of their exposure."""
