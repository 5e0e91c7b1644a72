"""`companion settings`: what each setting means."""
