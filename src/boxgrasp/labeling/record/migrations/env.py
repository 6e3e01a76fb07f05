"""Runs the migrations in the transaction of `connection.py`; Alembic reads this file."""

from alembic import context

from boxgrasp.labeling.record.tables import METADATA

context.configure(
    target_metadata=METADATA,
    **context.config.attributes["boxgrasp"],  # the connection, and the table of the version
)
context.run_migrations()
