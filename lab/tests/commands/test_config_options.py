import argparse
from typing import Literal

import pytest
from pydantic import Field

from echoavatar.config import Config
from echoavatar_lab.commands.config_options import add_fields, given_fields


class Sizes(Config):
    learning_rate: float = Field(default=0.5, description="100 % of it")
    order: Literal["up", "down"] = Field(default="up", description="which way")
    steps: int = Field(default=3, description="how many")
    seed: int | None = Field(default=None, description="where to begin")


NAMES = ("learning_rate", "order", "steps", "seed")


def parser(**how: object) -> argparse.ArgumentParser:
    made = argparse.ArgumentParser()
    add_fields(made, Sizes, NAMES, **how)
    return made


def test_only_what_is_given_is_set_and_has_the_fields_type() -> None:
    given = parser().parse_args(["--learning-rate", "2", "--order", "down", "--seed", "0"])
    assert given_fields(given, (*NAMES, "has_no_option")) == {"learning_rate": 2.0, "order": "down", "seed": 0}


def test_other_values_than_a_literals_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parser().parse_args(["--order", "sideways"])
    assert "invalid choice: 'sideways'" in capsys.readouterr().err


def test_help_names_the_default_that_applies() -> None:
    assert "100 % of it (default: 0.5)" in parser().format_help()
    assert "where to begin (default: none)" in parser().format_help()
    assert "how many (default: the recipe's)" in parser(default="the recipe's").format_help()
    told = " ".join(parser(default={"steps": 9}).format_help().split())
    assert "how many (default: 9)" in told
    assert "which way (default: up)" in told
