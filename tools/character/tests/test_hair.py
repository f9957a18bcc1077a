from echoavatar_character.hair import STRIPS, paint_hair
from echoavatar_character.person import PEOPLE


def test_strands_are_dense_at_the_root_and_part_at_the_tip() -> None:
    picture = paint_hair(PEOPLE["maya"], 256)
    opaque = picture[..., 3] > 0.5
    assert opaque[60:120].mean() > 0.5
    assert opaque[-8:].mean() < 0.5 * opaque[60:120].mean()
    for strip in range(STRIPS):
        assert opaque[:, strip * 64 : strip * 64 + 64].mean() > 0.2
