import pytest

from echoavatar.agents.proxy import ProxySettings
from echoavatar.errors import EchoAvatarError


@pytest.mark.parametrize("url", ["", "https://api.openai.com/v1/realtime", "wss://", "api.openai.com"])
def test_an_invalid_upstream_is_refused_with_an_example(url: str) -> None:
    with pytest.raises(EchoAvatarError, match="wss://api.openai.com"):
        ProxySettings(url)
