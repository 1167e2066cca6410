"""What everything stands on: errors, words, reading, typed specs, rank, the QP and time tables."""
