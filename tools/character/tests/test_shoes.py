import numpy as np

from echoavatar_character import clothes
from echoavatar_character.body import Body
from echoavatar_character.shoes import shoes


def test_a_shoe_goes_round_each_foot_and_stands_on_the_floor(body: Body) -> None:
    pieces = shoes(body, clothes.tights(body))
    for side in ("left", "right"):
        ankle = body.joint(f"{side}Foot")
        own = np.concatenate([p.positions for p in pieces if np.sign(p.positions[:, 0].mean()) == np.sign(ankle[0])])
        assert 0.22 < np.ptp(own[:, 2]) < 0.34
        assert 0.07 < np.ptp(own[:, 0]) < 0.14
        assert own[:, 1].min() < ankle[1] - 0.05
