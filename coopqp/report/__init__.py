"""What a comparison looks like: a page for the browser, a table for the terminal, files for more."""
