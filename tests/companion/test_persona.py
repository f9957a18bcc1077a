from echoavatar.companion import PERSONA


def test_it_is_short_and_names_only_tools_that_exist() -> None:
    assert len(PERSONA) < 1_200
    assert {"send_action", "play_music", "stop_music"} <= set(PERSONA.replace(",", " ").split())
    assert PERSONA.isascii()
