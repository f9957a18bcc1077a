from echoavatar.agents.integrations.persona import persona


def test_the_prompt_lists_actions_and_tracks() -> None:
    text = persona(["wave", "bow"], ["Waltz"], name="Mika", surroundings="The record store is on the right.")
    for told in ("Mika", "wave, bow", "Waltz", "record store", "Producer", "send_action", "play_music", "stop_music"):
        assert told in text
    assert "{" not in text


def test_the_prompt_says_if_there_are_none() -> None:
    assert "none yet" in persona([], [])
