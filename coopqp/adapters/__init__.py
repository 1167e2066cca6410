"""Other people's worlds: their names and units, and what coopqp does for them there."""
