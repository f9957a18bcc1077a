from pathlib import Path

import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar.server.companion import ChatModel, Scripted, from_environment

URL = "http://127.0.0.1:9/v1"


def test_nothing_configured_is_the_script() -> None:
    assert isinstance(from_environment({}), Scripted)


def test_an_endpoint_is_a_model_with_the_persona_of_a_file(tmp_path: Path) -> None:
    (tmp_path / "me.txt").write_text("You are a lamp.")
    given = {
        "ECHOAVATAR_CHAT_URL": URL,
        "ECHOAVATAR_CHAT_MODEL": "m",
        "ECHOAVATAR_CHAT_EARS": "whisper",
        "ECHOAVATAR_PERSONA": str(tmp_path / "me.txt"),
    }
    model = from_environment(given)
    assert isinstance(model, ChatModel)
    assert (model.name, model.hears, model._persona) == ("m", True, "You are a lamp.")


@pytest.mark.parametrize(
    ("given", "remedy"),
    [
        ({"ECHOAVATAR_CHAT_URL": URL}, "ECHOAVATAR_CHAT_MODEL"),
        ({"ECHOAVATAR_CHAT_URL": "file:///etc", "ECHOAVATAR_CHAT_MODEL": "m"}, "not an address"),
        ({"ECHOAVATAR_CHAT_URL": URL, "ECHOAVATAR_CHAT_MODEL": "m", "ECHOAVATAR_PERSONA": "/nowhere"}, "cannot read"),
    ],
)
def test_mistakes_are_said(given: dict[str, str], remedy: str) -> None:
    with pytest.raises(EchoAvatarError, match=remedy):
        from_environment(given)
