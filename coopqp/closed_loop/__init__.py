"""Sections 3 and 4 of the paper: what closed loops allow, and how they move under forces."""
