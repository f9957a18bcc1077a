"""Alembic migrations of the store, applied when it is opened. May import `tables`."""
