from echoavatar.files.avatar import CHARACTERS
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar_character.clothes import CUTS
from echoavatar_character.hair import STYLES
from echoavatar_character.person import PEOPLE


def test_all_who_ship_are_known_and_differ() -> None:
    assert tuple(PEOPLE) == CHARACTERS
    assert len({person.skin for person in PEOPLE.values()}) == len(PEOPLE)
    for person in PEOPLE.values():
        assert person.hair_style in STYLES
        assert person.cut in CUTS
        assert len({outfit.name for outfit in person.outfits}) == len({outfit.top for outfit in person.outfits}) == 3
        assert set(person.rest) <= set(ARKIT_NAMES)
        assert person.rest["mouthSmileLeft"] > 0  # a friendly face at rest
