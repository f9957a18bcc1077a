"""Markup in every text that the studio stores, shown on every page of a real browser: it stays text.

The browser is told to ignore the pages' security policy, so that a script would run if markup ever became an element.
"""

from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("sqlalchemy")
pytest.importorskip("psycopg")

from sqlalchemy import String, update  # noqa: E402
from studio.tests import canned  # noqa: E402
from studio.tests.conftest import STORES, cluster, postgres, store_of  # noqa: E402, F401
from studio.tests.raters_in_browser import RaterTab, Studio  # noqa: E402
from tests.web.conftest import PageDriver  # noqa: E402

from echoavatar_studio.owner_actions import OwnerActions  # noqa: E402
from echoavatar_studio.results import results  # noqa: E402
from echoavatar_studio.secrecy import hash_password  # noqa: E402
from echoavatar_studio.simulate import Preferences, simulate  # noqa: E402
from echoavatar_studio.tables import Owner, Study, System, Table  # noqa: E402

pytestmark = pytest.mark.browser
MARKUP = "<b-ad><img src=x onerror=harmed=1>"
HARM = "document.querySelectorAll('b-ad, [onerror], a[href^=\"javascript:\"]').length + (window.harmed ?? 0)"
SHOWN = "document.body.innerText + [...document.querySelectorAll('input, textarea')].map((at) => at.value)"
# columns that we write ourselves, whatever people enter
OWN = {
    "owners": {"password"},
    "studies": {"public", "kind", "state", "settings"},  # settings hold the texts that the study is made with
    "systems": {"name"},  # as the settings say
    "sounds": {"category", "path"},
    "clips": {"path"},
    "trials": {"role"},
    "invitations": {"token_hash"},
    "raters": {"token_hash"},
    "tasks": {"public"},
    "judgements": {"key", "digest", "skipped"},
    "logins": {"token_hash", "csrf"},
    "events": {"study"},
}


@pytest.fixture(scope="module", params=STORES)
def studio(request: pytest.FixtureRequest, tmp_path_factory: Any) -> Iterator[Studio]:
    library = tmp_path_factory.mktemp("library")
    canned.library(library, sounds=8)
    with Studio(canned.studio(tmp_path_factory.mktemp("studio"), store_of(request)), library).serving() as served:
        yield served


@pytest.fixture
def tab(browser: Any) -> Iterator[PageDriver]:
    context = browser.new_context(viewport={"width": 1100, "height": 800}, bypass_csp=True)
    yield PageDriver(context.new_page())
    context.close()


def spoil(studio: Studio, study: str) -> list[str]:
    """Write the markup into every text of every table; returns their names."""
    spoilt = []
    with studio.maker.store.write() as session:
        session.add(Owner(name="second", password=hash_password(canned.PASSWORD), created=0.0))
        session.flush()
        for table in Table.metadata.sorted_tables:
            for column in table.columns:
                if isinstance(column.type, String) and column.name not in OWN.get(table.name, ()):
                    spoilt.append(f"{table.name}.{column.name}")
                    if spoilt[-1] == "sounds.name":  # unique in a study
                        session.execute(update(table).values({column: MARKUP + table.c.path}))
                    elif spoilt[-1] == "owners.name":
                        session.execute(update(table).values({column: MARKUP}).where(table.c.name == "second"))
                    else:
                        session.execute(update(table).values({column: MARKUP}))
        session.execute(update(Study).values(state="failed").where(Study.public != study))
        assert session.query(System).filter(System.name.startswith(MARKUP)).count() == 3
    return spoilt


def test_markup_in_any_stored_text_stays_text_on_every_page(studio: Studio, tab: PageDriver) -> None:
    names = [f"{MARKUP} {name}" for name in canned.SYSTEMS]
    systems = [
        {"name": name, "clips": clips, "group": MARKUP} for name, clips in zip(names, canned.SYSTEMS, strict=True)
    ]
    texts = {"title": MARKUP, "intro": MARKUP, "consent": MARKUP, "systems": systems}
    study, failed = studio.pairwise(**texts, raters=6), studio.pairwise(title="Failed")
    worth = Preferences(worth=dict(zip(names, (0.8, 0.0, -0.8), strict=True)))
    actions = OwnerActions(studio.maker, "test")
    simulate(studio.maker.store, actions, study, worth, raters=4, seed=1)
    link = studio.links(study)[0]
    spoilt = spoil(studio, study)
    assert {"owners.name", "studies.problem", "invitations.label", "raters.reason", "events.detail"} <= set(spoilt)

    page = tab.page
    page.goto(studio.url)
    tab.wait("!!document.querySelector('.sign-in')")
    page.fill("[name=name]", MARKUP)
    page.fill("[name=password]", canned.PASSWORD)
    page.click(".sign-in button")
    tab.wait("!!document.querySelector('.top')")
    tabs = ("overview", "invite", "raters", "results", "settings", "audit")
    for place in ("", "new", "audit", f"study/{failed}/overview", *(f"study/{study}/{name}" for name in tabs)):
        page.evaluate(f"location.hash = '#/{place}'")
        if place != "new":
            tab.wait(f"({SHOWN}).includes({MARKUP!r})")
        page.wait_for_load_state("networkidle")
        assert tab.ask(HARM) == 0, place
    plots = results(studio.maker.store, study).plots
    assert plots
    for name in plots:
        drawn = "new DOMParser().parseFromString(text, 'image/svg+xml').querySelectorAll('b-ad, [onerror]').length"
        fetched = f"await (await fetch('/api/owner/studies/{study}/export/{name}')).text()"
        assert page.evaluate(f"async () => {{ const text = {fetched}; return {drawn}; }}") == 0, name

    rater = RaterTab(page)
    page.goto(link)
    rater.see(".agree")
    assert MARKUP in tab.ask(SHOWN)
    assert tab.ask(HARM) == 0
    page.click(".agree")
    rater.see(".task")
    assert tab.ask(HARM) == 0

    page.evaluate(f"document.body.insertAdjacentHTML('beforeend', {MARKUP!r})")  # this test sees harm where it is done
    tab.wait("window.harmed === 1")
    assert tab.ask(HARM) > 1
