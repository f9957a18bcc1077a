from echoavatar.server.answers import TrackWatch, answer
from echoavatar.wire import ActionStatus


def test_a_track_is_followed_from_the_asking_to_its_end() -> None:
    watch = TrackWatch()
    told: list[ActionStatus] = watch.follow(0, has_music=False)
    told += watch.ask("a", "Evening", 0)
    told += watch.follow(6_400, has_music=False)  # made before it was asked for
    for at in (12_800, 19_200):
        told += watch.follow(at, has_music=True)
    assert watch.title == "Evening"
    told += watch.ask("b", "Morning", 25_600)
    told += watch.follow(25_600, has_music=True)
    told += watch.follow(32_000, has_music=False)
    assert [(s.id, s.status, s.at) for s in told] == [
        ("a", "accepted", 0),
        ("a", "started", 12_800),
        ("a", "done", 25_600),
        ("b", "accepted", 25_600),
        ("b", "started", 25_600),
        ("b", "done", 32_000),
    ]
    assert watch.title == ""


def test_a_rejection_names_the_choices() -> None:
    assert answer("x", "fly", "rejected", 0, reason="no", choices=("wave",)).choices == ("wave",)
