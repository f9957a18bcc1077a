"""The finger model that the finger tests train, for its scores."""

from lab.tests.models.fingers.conftest import model, trained

__all__ = ["model", "trained"]
