"""What a comparison looks like: a page to read, a table for the terminal, files for the rest."""
