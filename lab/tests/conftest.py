from tests.conftest import own_cache, pytest_pyfunc_call, swaying, tiny_bundle, voice  # noqa: F401
