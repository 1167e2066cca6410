"""One tick of the QP law, in reading order from :mod:`coopqp.qp_law.law`."""
