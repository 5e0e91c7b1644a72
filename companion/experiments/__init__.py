"""The paper's experiments, each one command with a table and a plot (`companion-experiments`)."""
