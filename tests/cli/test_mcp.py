import builtins

import pytest

from echoavatar.cli import main


def test_without_the_package_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = builtins.__import__

    def lacking(name: str, *rest: object) -> object:
        if name in ("mcp", "mcp_types") or name.startswith("mcp."):
            level = rest[3] if len(rest) > 3 else 0
            if not level:
                raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, *rest)  # type: ignore[arg-type]

    import sys

    for known in [name for name in sys.modules if name.startswith("echoavatar.agents.mcp")]:
        monkeypatch.delitem(sys.modules, known)
    monkeypatch.setattr(builtins, "__import__", lacking)
    assert main(["mcp"]) == 1
    assert "pip install 'echoavatar[mcp]'" in capsys.readouterr().err
