"""Annotated shapes are checked in every test run, in whatever folder it begins."""

import tests.shapes  # noqa: F401  the hook looks its checker up by name
from jaxtyping import install_import_hook

install_import_hook(["echoavatar", "echoavatar_studio", "echoavatar_research"], "tests.shapes.checked")
