"""What every stage shares: messages, geometry, the clock, formats."""
