import sys
import tomllib
from pathlib import Path

import pytest

from echoavatar.cli import doctor, main
from echoavatar.errors import CheckpointError, DependencyError


def test_the_doctor_finds_what_is_needed_working(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    for thing in ("python", "torch", "modules", "default bundle", "motion", "files"):
        assert f"ok  {thing}" in said


def test_a_broken_bundle_is_reported_with_its_remedy(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from echoavatar.engine import pipeline

    def broken(name: str) -> None:
        raise CheckpointError(f"{name} is damaged; download it again")

    monkeypatch.setattr(pipeline, "load_bundle", broken)
    monkeypatch.setattr(doctor, "_modules", list)
    assert main(["doctor"]) == 1
    said = capsys.readouterr().out
    assert "!!  default bundle" in said
    assert "download it again" in said


def test_an_environment_in_which_animate_crashes_is_not_called_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """As NumPy 2.5 did: everything was found, and `animate` ended in a traceback."""
    from echoavatar import animation

    def crash(*_: object) -> None:
        raise TypeError("issubclass() arg 1 must be a class")

    monkeypatch.setattr(animation, "animate", crash)
    ((mark, what, remark),) = doctor._motion()
    assert (mark, what) == (doctor.BROKEN, "motion")
    assert "TypeError: issubclass() arg 1 must be a class" in remark


def test_a_module_that_does_not_load_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "echoavatar.files.exports.usd", None)
    faults = [finding for finding in doctor._modules() if finding[0] == doctor.BROKEN]
    assert [what for _, what, _ in faults] == ["files"]
    assert "echoavatar.files.exports.usd does not load" in faults[0][2]


def test_only_packages_of_an_extra_may_be_absent() -> None:
    absent = doctor._failure("echoavatar.server.run", ModuleNotFoundError(name="starlette.routing"))
    assert absent == (doctor.OPTIONAL, "server", "needs starlette; pip install 'echoavatar[serve]'")
    assert doctor._failure("echoavatar.models.audio.io", ModuleNotFoundError(name="soxr"))[0] == doctor.BROKEN
    assert doctor._failure("echoavatar.agents.mcp", DependencyError("x"))[0] == doctor.OPTIONAL
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    assert set(doctor.EXTRA_OF.values()) <= set(project["optional-dependencies"])


@pytest.mark.parametrize("is_there", [True, False])
def test_what_the_lab_and_the_studio_add_is_said(monkeypatch: pytest.MonkeyPatch, is_there: bool) -> None:
    monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda name: name if is_there else None)
    found = {what: (mark, remark) for mark, what, remark in doctor._separate()}
    mark, remark = found["echoavatar-lab"]
    assert "`train`" in remark
    assert "`studio`" not in remark
    assert ("pip install ./lab" not in remark) == is_there == (mark == doctor.OK)
    assert ("flite" in found) == is_there
    assert "`studio`" in found["echoavatar-studio"][1]
