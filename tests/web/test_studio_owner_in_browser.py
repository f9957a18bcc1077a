"""The studio's owner pages in a real browser against the real studio: set up, invite, watch, read, export, delete."""

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("sqlalchemy")
pytest.importorskip("psycopg")

from studio.tests import canned  # noqa: E402
from studio.tests.conftest import STORES, cluster, postgres, store_of  # noqa: E402, F401
from studio.tests.raters_in_browser import NAMELESS, OUTSIDE, PALE, Studio  # noqa: E402
from tests.web.conftest import PageDriver  # noqa: E402

from echoavatar_studio.owner_actions import OwnerActions  # noqa: E402
from echoavatar_studio.simulate import Preferences, simulate  # noqa: E402

pytestmark = pytest.mark.browser
PREFERENCES = Preferences(worth={"Alpha": 0.8, "Beta": 0.0, "Gamma": -0.8})


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("library")
    canned.library(folder, sounds=8, seconds=1.0)
    return folder


@pytest.fixture(scope="module", params=STORES)
def studio(request: pytest.FixtureRequest, library: Path, tmp_path_factory: Any) -> Iterator[Studio]:
    """One studio on SQLite, then one on PostgreSQL: every test below runs on both."""
    with Studio(canned.studio(tmp_path_factory.mktemp("studio"), store_of(request)), library).serving() as served:
        yield served


@pytest.fixture(scope="module")
def judged(studio: Studio) -> str:
    """A pairwise study with the answers of eight made-up raters."""
    study = studio.pairwise(title="Judged", raters=10, tasks_per_rater=12)
    simulate(studio.maker.store, OwnerActions(studio.maker, "test"), study, PREFERENCES, raters=8, seed=1)
    return study


class OwnerTab(PageDriver):
    def sign_in(self, url: str, password: str = canned.PASSWORD) -> "OwnerTab":
        self.page.goto(url)
        self.see(".sign-in")
        self.page.fill("[name=name]", "anna")
        self.page.fill("[name=password]", password)
        self.page.click(".sign-in button")
        return self

    def see(self, selector: str) -> None:
        self.wait(f"!!document.querySelector({json.dumps(selector)})", 60)

    def text(self, words: str) -> None:
        self.wait(f"document.body.innerText.includes({json.dumps(words)})", 60)

    def go(self, *names: str) -> None:
        address = f"#/{'/'.join(names)}"
        self.page.evaluate(f"location.hash = {json.dumps(address)}")
        here = "[...document.querySelectorAll('nav a[aria-current]')]"
        self.wait(f"{here}.some((link) => link.hash === {json.dumps(address)})", 60)


def test_who_has_not_signed_in_is_asked_nothing_and_a_reload_stays_signed_in(browser: Any, studio: Studio) -> None:
    """The sign-in page asks for no session, so no browser logs a 401."""
    context = browser.new_context()
    page, refused = context.new_page(), list[str]()
    page.on("response", lambda answer: refused.append(answer.url) if answer.status >= 400 else None)
    tab = OwnerTab(page).sign_in(studio.url)
    tab.see(".top")
    page.reload()
    tab.see(".top")
    assert not refused
    context.close()


@pytest.fixture
def owner(browser: Any, studio: Studio) -> Iterator[OwnerTab]:
    context = browser.new_context(viewport={"width": 1100, "height": 800})
    tab = OwnerTab(context.new_page()).sign_in(studio.url)
    tab.see(".top")
    yield tab
    context.close()


def test_a_wrong_password_opens_nothing(browser, studio):
    context = browser.new_context()
    tab = OwnerTab(context.new_page()).sign_in(studio.url, "a wrong password")
    tab.text("Name or password is wrong.")
    assert context.cookies() == []
    context.close()


def test_a_study_is_set_up_in_the_form_and_opens(studio, owner):
    owner.go("new")
    page = owner.page
    page.fill("[name=title]", "Made in the page")
    page.click(".switch button")  # the form, still
    page.select_option(".system >> nth=0 >> select", "clips")
    for number, name in enumerate(canned.SYSTEMS[:2]):
        page.fill(f".system >> nth={number} >> [name=name]", name)
        page.fill(f".system >> nth={number} >> [name=clips]", name)
    page.fill(".sound [name=path]", "speech")
    page.fill("[name=seconds]", "1")
    page.fill("[name=raters]", "2")
    page.fill("[name=tasks_per_rater]", "2")
    page.evaluate("() => { const make = document.querySelector('.make'); make.click(); make.click(); }")
    owner.see(".tabs")
    owner.wait("document.querySelector('.state')?.textContent === 'open'", 60)
    titles = [row.title for row in OwnerActions(studio.maker, "test").studies().studies]
    assert titles.count("Made in the page") == 1


def test_what_the_form_lacks_is_pointed_at_and_what_the_studio_refuses_is_said(studio, owner):
    owner.go("new")
    owner.page.click(".make")
    assert owner.ask("document.activeElement.name") == "title"
    owner.page.click(".switch button >> nth=1")
    owner.page.fill(".yaml", "kind: pairwise\ntitle: Nothing\n")
    owner.page.click(".make")
    owner.text("The studio did not accept this")
    assert owner.ask("location.hash") == "#/new"


def test_links_are_shown_once_and_can_be_revoked(studio, owner):
    study = studio.pairwise(title="Inviting")
    owner.go("study", study, "invite")
    owner.page.fill("[type=number]", "3")
    owner.page.click(".fields button")
    owner.see(".links")
    links = owner.page.input_value(".links").split()
    assert len(links) == len(set(links)) == 3
    assert all(link.startswith(f"{studio.url}/rate#") for link in links)
    owner.page.reload()
    owner.see(".table")
    assert owner.page.query_selector(".links") is None
    owner.page.click("td button >> nth=0")
    owner.page.click("dialog [value=yes]")
    owner.text("revoked")


def test_progress_is_live(studio, owner):
    study = studio.pairwise(title="Live")
    owner.go("study", study, "overview")
    owner.text("0 of 12 judgements")
    simulate(studio.maker.store, OwnerActions(studio.maker, "test"), study, PREFERENCES, raters=1, seed=3)
    owner.text("3 of 12 judgements")
    owner.text("1 of 4 raters")


def test_results_show_what_the_raters_think(judged, owner, tmp_path):
    owner.go("study", judged, "results")
    for words in ("Scores", "Bradley-Terry ranking", "Agreement between raters", "Alpha against Gamma"):
        owner.text(words)
    labels = "[...document.querySelectorAll('.plots figure:first-child .label')]"
    ranked = owner.ask(f"{labels}.map((label) => label.textContent)")
    assert ranked == ["1. Alpha", "2. Beta", "3. Gamma"]
    values = owner.ask("[...document.querySelectorAll('.plot title')].map((title) => title.textContent)")
    assert any(value.startswith("Alpha: +") for value in values)
    assert any(value.startswith("Gamma: −") for value in values)
    assert owner.ask(NAMELESS) == []
    owner.shot(tmp_path / "results.png")


def test_files_are_taken_away(judged, owner, tmp_path):
    owner.go("study", judged, "results")
    owner.see(".export")
    names = owner.ask("[...document.querySelectorAll('.export')].map((link) => link.download)")
    assert {"judgements.csv", "results.json", "table.tex"} <= set(names)
    for name in names:
        with owner.page.expect_download() as waiting:
            owner.page.click(f".export[download='{name}']")
        waiting.value.save_as(tmp_path / name)
        assert (tmp_path / name).stat().st_size > 20
    with (tmp_path / "judgements.csv").open(newline="") as file:
        assert len(list(csv.reader(file))) > 8 * 12
    assert json.loads((tmp_path / "results.json").read_text())["kind"] == "pairwise"
    assert "\\begin{tabular}" in (tmp_path / "table.tex").read_text()


def test_a_rater_is_left_out_and_another_deleted_on_request(studio, owner):
    study = studio.pairwise(title="Leaving")
    simulate(studio.maker.store, OwnerActions(studio.maker, "test"), study, PREFERENCES, raters=2, seed=4)
    before = len(studio.judgements(study))
    owner.go("study", study, "raters")
    owner.page.click(".exclude >> nth=0")
    owner.page.fill("dialog input", "looked away")
    owner.page.click("dialog [value=yes]")
    owner.text("left out")
    owner.page.click(".delete-rater >> nth=1")
    owner.page.click("dialog [value=no]")
    assert len(studio.judgements(study)) == before
    owner.page.click(".delete-rater >> nth=1")
    owner.page.click("dialog [value=yes]")
    owner.wait("document.querySelectorAll('.delete-rater').length === 1")
    assert len(studio.judgements(study)) == before // 2
    owner.go("study", study, "audit")
    owner.text("looked away")
    owner.text("rater excluded")


def test_a_study_is_closed_and_deleted(studio, owner):
    study = studio.pairwise(title="Passing")
    owner.go("study", study, "overview")
    owner.page.click(".close-study")
    owner.see(".delete-study")
    owner.page.click(".delete-study")
    owner.page.click("dialog [value=yes]")
    owner.see(".studies")
    assert study not in [row.id for row in OwnerActions(studio.maker, "test").studies().studies]


def test_titles_are_text_and_never_markup(studio, owner):
    title = "<img src=x onerror=\"document.title='harmed'\">"
    study = studio.pairwise(title=title)
    owner.go("study", study, "overview")
    assert owner.page.inner_text("h1") == title
    assert owner.page.title() == "Studio"


def test_signing_out_ends_the_session(studio, owner):
    owner.page.click(".sign-out")
    owner.see(".sign-in")
    owner.page.reload()
    owner.see(".sign-in")
    owner.page.evaluate("location.hash = '#/audit'")
    assert owner.page.query_selector(".top") is None


@pytest.mark.parametrize(("width", "height", "colours"), [(360, 640, "dark"), (1280, 800, "light")])
def test_nothing_is_cut_off_or_pale_and_everything_has_a_name(judged, owner, width, height, colours, tmp_path):
    owner.page.set_viewport_size({"width": width, "height": height})
    owner.page.emulate_media(color_scheme=colours)
    tabs = ("overview", "invite", "raters", "results", "settings")
    places = [("new",), ("audit",), *(("study", judged, tab) for tab in tabs)]
    for place in places:
        owner.go(*place)
        assert owner.ask(OUTSIDE) == [], place
        assert owner.ask(PALE) == [], place
        assert owner.ask(NAMELESS) == [], place
        assert owner.ask("document.documentElement.scrollWidth <= innerWidth"), place
        owner.page.screenshot(path=tmp_path / f"{place[-1]}-{width}.png", full_page=True)
