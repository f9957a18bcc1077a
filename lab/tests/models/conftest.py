from lab.tests.models.fingers.conftest import model, trained  # noqa: F401
