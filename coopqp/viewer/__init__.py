"""``coopqp play``: a page in the browser that runs the laws of a scenario and lets people drag.

Three processes, so that neither drawing nor explaining holds a law up:

player         this one: the laws, tick by tick in real time, and what people have asked for
page           the web server (viser): scene and panel
explainer      what keeps the arms from their goals

live           constants of tasks become inputs that can be dragged
dials          gains, weights, kappa and priorities as sliders
lane           one law with its plant
picture        what is drawn of a lane
recording      what was sent, as a scenario that ``coopqp compare`` replays
messages       what goes from process to process
beside         a process beside the loop, that gets the newest and never holds it up
"""
