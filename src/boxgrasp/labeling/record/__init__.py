"""The record of labels: a database in which nothing is overwritten."""

from boxgrasp.labeling.record.database import Record

__all__ = ["Record"]
