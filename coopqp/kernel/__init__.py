"""The compiled tick: C++ in ``core/``, and the thin Python side that fills its arrays."""
