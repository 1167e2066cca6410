"""One answer to every question about a run."""
