"""The adapters, and chunks that break limits on purpose: ``python -m tests.adapters``."""
