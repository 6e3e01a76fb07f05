"""Many independent tasks on all cores or on a Dask cluster, and what is finished is kept."""

from __future__ import annotations

from boxgrasp.execution.background import Background
from boxgrasp.execution.parts import finish
from boxgrasp.execution.store import Store
from boxgrasp.execution.workers import Workers, cluster_workers, local_workers, workers_for

__all__ = [
    "Background",
    "Store",
    "Workers",
    "cluster_workers",
    "finish",
    "local_workers",
    "workers_for",
]
