"""What only the paper's figures and our own comparisons need."""
