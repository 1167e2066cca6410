"""What runs many rollouts: processes of this machine or a Dask cluster, through joblib's interface.

batches    items in batches of about a second
processes  loky's processes on this machine
cluster    workers of a Dask scheduler
engine     the results of all items, whatever becomes of the workers
"""

from coopqp.study.engine.engine import Engine, Lost, Share

__all__ = ["Engine", "Lost", "Share"]
