"""A simulation put together and run, in process or as a process of its own."""
