import pytest

from echoavatar.cli import main


def test_the_doctor_finds_what_is_needed_working(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    for thing in ("python", "torch", "default bundle"):
        assert f"ok  {thing}" in said


def test_a_broken_bundle_is_reported_with_its_remedy(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from echoavatar import pipeline
    from echoavatar.errors import CheckpointError

    def broken(name: str) -> None:
        raise CheckpointError(f"{name} is damaged; download it again")

    monkeypatch.setattr(pipeline, "load_bundle", broken)
    assert main(["doctor"]) == 1
    said = capsys.readouterr().out
    assert "!!  default bundle" in said
    assert "download it again" in said
