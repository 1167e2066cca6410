"""What runs many rollouts: processes of this machine or a Dask cluster, through joblib's interface.

workers    items in batches of about a second, and loky's processes, which do them on this machine
cluster    workers of a Dask scheduler
engine     the results of all items, whatever becomes of the workers
"""

from coopqp.study.engine.engine import Engine, Lost, Share

__all__ = ["Engine", "Lost", "Share"]
