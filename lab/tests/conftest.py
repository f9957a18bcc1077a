from tests.conftest import own_cache, pytest_pyfunc_call, tiny_bundle, voice  # noqa: F401
