"""The truth: vehicle, pad and sky stepped together, contact, and the score."""
