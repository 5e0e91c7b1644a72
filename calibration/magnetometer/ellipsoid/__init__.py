"""The ellipsoid fit: raw field in, offset (hard iron) and matrix (soft iron) out."""
