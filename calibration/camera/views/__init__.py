"""Images in, corners of the board out, and how much of the image they cover."""
