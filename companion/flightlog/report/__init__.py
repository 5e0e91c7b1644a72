"""What a person looks at after a flight: the table, the plots as pictures, and the page."""
