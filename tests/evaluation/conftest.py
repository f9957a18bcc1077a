"""A finger model to score."""

from tests.models.fingers.conftest import model, trained

__all__ = ["model", "trained"]
