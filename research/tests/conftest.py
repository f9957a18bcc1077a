from tests.conftest import own_cache, tiny_bundle, voice  # noqa: F401
