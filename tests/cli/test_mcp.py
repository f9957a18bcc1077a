import builtins
from typing import Any

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


@pytest.mark.parametrize(
    ("words", "environment", "token", "shown"),
    [
        ([], "", "", False),
        (["--host", "0.0.0.0"], "", "made up", True),
        (["--host", "0.0.0.0"], "own", "own", False),
        (["--host", "0.0.0.0", "--agent-token", "own"], "", "own", False),
        (["--agent-token", "own"], "other", "own", False),
    ],
)
def test_agents_need_a_token_on_a_network_and_it_is_not_the_servers(
    words: list[str],
    environment: str,
    token: str,
    shown: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("mcp")
    monkeypatch.setenv("ECHOAVATAR_AGENT_TOKEN", environment)
    monkeypatch.setenv("ECHOAVATAR_TOKEN", "of-the-server")
    given: list[dict[str, Any]] = []

    async def announce(tools: object, **options: Any) -> None:
        given.append(options)
        options["on_ready"]("http://127.0.0.1:8767")

    monkeypatch.setattr("echoavatar.agents.mcp.serve_http", announce)
    assert main(["mcp", "--http", *words]) == 0
    told, used = capsys.readouterr().err, given[0]["token"]
    assert used == token or (token == "made up" and len(used) >= 22)
    assert (f"token: {used}" in told) == shown
    assert "of-the-server" not in told + used
