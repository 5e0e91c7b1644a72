"""The camera's file, the summary and the plots."""
