"""``coopqp play``: a page in the browser that runs controllers and lets people drag their goals.

Three processes, so that neither drawing nor explaining delays the control loop: the player runs the
controllers in real time, ``page`` serves the page (viser), ``explainer`` says what keeps the arms
from their goals. ``worker`` starts the other two, ``messages`` is what goes between them.
"""
