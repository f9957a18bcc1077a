from echoavatar.integrations.persona import persona


def test_the_prompt_names_what_there_is() -> None:
    text = persona(["wave", "bow"], ["Waltz"], name="Mika", surroundings="The record store is on the right.")
    for told in (
        "Mika",
        "wave, bow",
        "Waltz",
        "record store",
        "Producer",
        "send_action",
        "play_music",
        "stop_music",
    ):
        assert told in text
    assert "{" not in text


def test_without_anything_it_says_so() -> None:
    assert "none yet" in persona([], [])
