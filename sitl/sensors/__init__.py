"""Truth to what sensors measure."""
