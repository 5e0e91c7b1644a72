"""The mount's file, the summary and the plots."""
