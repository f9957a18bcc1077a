"""Migrations and tables agree: what they make is what the studio asks for."""

from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

from echoavatar_studio.store import Store
from echoavatar_studio.tables import Table


def test_the_migrated_store_is_what_the_tables_say(tmp_path):
    store = Store(f"sqlite:///{tmp_path / 'a.db'}")
    with store.engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Table.metadata) == []
    store.close()
