"""`companion detect`: what vision finds of the pad in the user's own photos and videos."""
