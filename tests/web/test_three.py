"""The built pages and the one copy of three.js that they import."""

import re
from hashlib import sha256
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
THREE = ROOT / "src/echoavatar/assets/shared/three.js"
PAGES = (
    "src/echoavatar/server/static/assets/index-*.js",
    "src/echoavatar/server/static/client/client-*.js",
    "studio/src/echoavatar_studio/static/assets/rate-*.js",
)


@pytest.mark.parametrize("page", PAGES)
def test_three_has_every_name_that_a_page_imports(page: str) -> None:
    """`web/src/three.js` lists them; no bundler sees that one is missing there."""
    three = THREE.read_text("utf-8")
    (exported,) = re.findall(r"export\{([^}]*)\};?\s*$", three)
    given = {name.split(" as ")[-1] for name in exported.split(",")}
    (path,) = ROOT.glob(page)
    imports = re.findall(r'import\{([^}]*)\}from"\.{1,2}/(?:assets/)?three\.js\?v=(\w+)"', path.read_text("utf-8"))
    taken = {name.split(" as ")[0] for names, _ in imports for name in names.split(",")}
    assert {"Vector3", "GLTFLoader", "PerspectiveCamera", "VRMLoaderPlugin"} <= taken <= given
    assert {version for _, version in imports} == {sha256(THREE.read_bytes()).hexdigest()[:8]}, "run `make web`"
