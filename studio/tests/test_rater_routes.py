"""Cookies and media of raters."""

from studio.tests import canned
from studio.tests.people import RaterPerson, app_of, tokens

from echoavatar_studio.making import Maker


def test_the_cookie_is_out_of_reach_of_scripts_and_other_sites(maker: Maker, library):
    study, app = canned.make_pairwise(maker, library), app_of(maker)
    one, two = tokens(maker, study, 2)
    cookie = RaterPerson(app).join(one).headers["set-cookie"]
    for part in ("studio_rater=", "HttpOnly", "SameSite=strict", "Path=/api/rater", "Max-Age="):
        assert part in cookie
    assert "Secure" not in cookie
    safe = RaterPerson(app)
    safe.http.base_url = "https://studio.test"
    assert "Secure" in safe.join(two).headers["set-cookie"]


def test_sound_comes_in_ranges(maker: Maker, library):
    study, app = canned.make_pairwise(maker, library), app_of(maker)
    rater = RaterPerson(app).begin(tokens(maker, study, 1)[0])
    address = rater.task()["audio"]
    whole = rater.get(address)
    part = rater.http.get(address, headers={"range": "bytes=4-11"})
    assert (part.status_code, part.content) == (206, whole.content[4:12])
    assert "private" in whole.headers["cache-control"]
