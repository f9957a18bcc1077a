from tests.conftest import tiny_bundle, voice  # noqa: F401
