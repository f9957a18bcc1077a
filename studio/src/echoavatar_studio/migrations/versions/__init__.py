"""One file per change of the tables, in the order of their numbers. May import SQLAlchemy and Alembic only."""
