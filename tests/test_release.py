"""What a release needs is there and agrees: versions, metadata, workflows, citation."""

import json
import re
import tomllib
from pathlib import Path

import yaml

import echoavatar

ROOT = Path(__file__).parents[1]
PROJECTS = [path for path in ROOT.glob("**/pyproject.toml") if not {"node_modules", "tools"} & set(path.parts)]


def test_every_distribution_has_the_version_and_says_what_it_is() -> None:
    assert len(PROJECTS) >= 5
    for path in PROJECTS:
        project = tomllib.loads(path.read_text("utf-8"))["project"]
        version = project.get("version", echoavatar.__version__ if "version" in project.get("dynamic", ()) else None)
        assert version == echoavatar.__version__, path
        assert {"authors", "classifiers", "keywords", "urls", "readme", "license"} <= project.keys(), path
    client = json.loads((ROOT / "web/packages/client/package.json").read_text("utf-8"))
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert client["version"] == citation["version"] == echoavatar.__version__


def test_the_workflows_call_what_exists() -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    targets = set(re.findall(r"^([\w./-]+):", makefile, re.M))
    called = set()
    for path in (ROOT / ".github/workflows").glob("*.yml"):
        flow = yaml.safe_load(path.read_text("utf-8"))
        steps = [step for job in flow["jobs"].values() for step in job["steps"]]
        called |= {name for step in steps for name in re.findall(r"^make ([\w./-]+)", step.get("run", ""), re.M)}
        for folder in re.findall(r"(?:lab/)?(?:scripts|tests)/[\w./]+", str(steps)):
            assert (ROOT / folder).exists(), folder
    assert called <= targets, called - targets
    tests = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text("utf-8"))["jobs"]["tests"]
    assert {"3.11", "3.14"} <= set(tests["strategy"]["matrix"]["python"])


def test_the_extras_that_doctor_names_exist() -> None:
    from echoavatar.cli.doctor import EXTRA_OF

    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    assert set(EXTRA_OF.values()) <= extras.keys()


def test_the_docs_name_every_extra_that_a_user_may_want() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    table = (ROOT / "docs/install.md").read_text("utf-8").partition("## Extras")[2].partition("\n## ")[0]
    assert set(re.findall(r"`(\w+)`", table)) >= extras.keys() - {"dev", "docs", "browser"}
