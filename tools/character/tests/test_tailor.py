import numpy as np
import pytest

from echoavatar_character import clothes, tailor
from echoavatar_character.body import Body
from echoavatar_character.shoes import shoes


@pytest.mark.parametrize("number", range(3))
def test_every_texel_of_the_clothes_is_painted(body: Body, number: int) -> None:
    """Of each outfit the jumper has its second colour and the trousers their belt; no texel keeps the ground."""
    cloth = clothes.tights(body)
    top, footwear = clothes.top(body, cloth), shoes(body, cloth)
    outfit = body.person.outfits[number]
    picture = tailor.picture(body, outfit, [top, clothes.trousers(cloth, footwear), *footwear], 256)
    assert np.isfinite(picture).all()
    for colour in (outfit.top, outfit.second, outfit.belt):
        assert (np.abs(picture - np.array(colour) / 255).max(2) < 0.06).mean() > 0.001
