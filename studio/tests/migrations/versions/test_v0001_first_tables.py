"""The first migration makes all tables."""

from pathlib import Path

from alembic import command
from alembic.config import Config
from sqlalchemy import create_engine, inspect

import echoavatar_studio as room


def test_it_makes_the_tables():
    engine = create_engine("sqlite://")
    with engine.begin() as connection:
        config = Config()
        config.set_main_option("script_location", str(Path(room.__file__).parent / "migrations"))
        config.attributes["connection"] = connection
        command.upgrade(config, "v0001")
        assert {"studies", "judgements", "events"} <= set(inspect(connection).get_table_names())
    engine.dispose()
