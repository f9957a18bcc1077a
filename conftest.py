"""With CHECK_SHAPES=1, annotated shapes and dtypes are checked while tests run, in whatever folder the run begins.

The check wraps every function of the packages, which makes small models up to twice as slow. `make test` therefore runs
all tests without it, and then a part of them with it (`SHAPED` in the Makefile).
"""

import os

if os.environ.get("CHECK_SHAPES"):
    import tests.shapes  # noqa: F401  the hook looks its checker up by name
    from jaxtyping import install_import_hook

    install_import_hook(["echoavatar", "echoavatar_studio", "echoavatar_research"], "tests.shapes.checked")
