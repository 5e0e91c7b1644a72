"""The pages for users, and what writes their tables and draws their pictures."""
