"""What a flight's log says in Foxglove's well-known messages beside our own."""
