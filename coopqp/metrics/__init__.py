"""The metrics: one file each, the file's name is the key in ``metrics.json``."""
