"""The studio's rater pages in a real browser against the real studio: whole studies, and failures."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("sqlalchemy")
pytest.importorskip("psycopg")

from studio.tests import canned  # noqa: E402
from studio.tests.conftest import STORES, cluster, postgres, store_of  # noqa: E402, F401
from studio.tests.raters_in_browser import NAMELESS, OUTSIDE, PALE, RaterTab, Studio, new_tab  # noqa: E402

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("library")
    canned.library(folder, seconds=1.0)
    return folder


@pytest.fixture(scope="module", params=STORES)
def studio(request: pytest.FixtureRequest, library: Path, tmp_path_factory: Any) -> Iterator[Studio]:
    """One studio on SQLite, then one on PostgreSQL: every test below runs on both."""
    with Studio(canned.studio(tmp_path_factory.mktemp("studio"), store_of(request)), library).serving() as served:
        yield served


@pytest.fixture
def tab(browser: Any) -> Iterator[Any]:
    made: list[RaterTab] = []

    def make(*size: int, **options: Any) -> RaterTab:
        made.append(new_tab(browser, *size, **options))
        return made[-1]

    yield make
    for one in made:
        one.page.context.close()


def test_the_store_is_what_the_test_is_named_after(studio, request):
    assert studio.maker.store.is_sqlite == ("sqlite" in request.node.name)


def test_whole_studies_of_both_kinds_by_several_raters_at_once(studio, tab):
    """Two raters of each of three studies, task by task in turn: every answer is stored once, for its rater."""
    studies = {
        studio.pairwise(presentation="side_by_side", tasks_per_rater=2, raters=2): 1 + 2 + 1,
        studio.pairwise(presentation="sequential", tasks_per_rater=2, raters=2): 1 + 2 + 1,
        studio.preference(raters=2): 1 + 2,
    }
    raters = [tab().begin(link) for study in studies for link in studio.links(study, 2)]
    while unfinished := [rater for rater in raters if not rater.is_finished]:
        for rater in unfinished:
            rater.judge(rating=1, best=2, worst=5)
    for study, tasks in studies.items():
        rows = studio.judgements(study)
        assert Counter(row.rater_id for row in rows) == dict.fromkeys({row.rater_id for row in rows}, tasks)
        assert len({row.rater_id for row in rows}) == 2
        assert len({row.task_id for row in rows}) == len(rows) == 2 * tasks
        assert all(min(row.plays) >= 1 and row.seconds > 0.5 for row in rows)
        if rows[0].best is None:
            assert {abs(row.overall_preference) for row in rows} == {1}
        else:
            assert all(row.best != row.worst for row in rows)
    for rater in raters:
        assert rater.problems == []


def test_a_reload_in_mid_judgement_loses_nothing(studio, tab):
    study = studio.pairwise(presentation="side_by_side")
    rater = tab().begin(studio.links(study)[0])
    rater.watch()
    rater.page.check("[data-question=beat_matching] input[value='-2']")
    before, plays = rater.task, rater.ask("__studio.player.plays")
    rater.page.reload()
    rater.see(".task")
    assert rater.task == before
    assert rater.page.is_checked("[data-question=beat_matching] input[value='-2']")
    assert min(rater.ask("__studio.player.plays")) >= min(plays) >= 1
    for question in ("human_likeness", "overall_preference"):
        rater.page.check(f"[data-question={question}] input[value='0']")
    rater.submit()
    (row,) = studio.judgements(study)
    assert abs(row.beat_matching) == 2
    assert row.seconds > 1  # the time before the reload counts


def test_without_a_line_nothing_is_said_to_be_saved_and_it_is_once_the_line_is_back(studio, tab):
    study = studio.pairwise(presentation="side_by_side")
    rater = tab().begin(studio.links(study)[0])
    rater.watch()
    rater.choose()
    before = rater.task
    rater.page.context.set_offline(True)
    rater.page.click(".submit")
    rater.wait("document.querySelector('.missing').textContent.startsWith('Not saved yet')")
    assert rater.task == before
    assert rater.page.query_selector(".note") is None
    assert studio.judgements(study) == []
    rater.page.context.set_offline(False)
    rater.passed(before)
    rater.wait("document.getElementById('said').textContent === 'Saved'")
    assert len(studio.judgements(study)) == 1


def test_an_answer_whose_receipt_is_lost_is_sent_again_and_kept_once(studio, tab):
    study = studio.preference()
    rater = tab(900, 640).begin(studio.links(study)[0])
    seen: list[str] = []

    def lose(route: Any) -> None:
        seen.append(route.request.headers["idempotency-key"])
        if len(seen) < 3:
            route.fetch()  # the studio stores it
            return route.abort()  # the page gets no answer
        return route.continue_()

    rater.page.route("**/answer", lose)
    rater.judge()
    assert len(seen) == 3
    assert len(set(seen)) == 1
    assert len(studio.judgements(study)) == 1


def test_a_reload_while_an_answer_is_on_its_way_sends_the_same_again(studio, tab):
    study = studio.pairwise(presentation="side_by_side")
    rater = tab().begin(studio.links(study)[0])
    keys: list[str] = []

    def cut(route: Any) -> None:
        keys.append(route.request.headers["idempotency-key"])
        route.abort()

    rater.page.route("**/answer", cut)
    rater.watch()
    rater.choose()
    before = rater.task
    rater.page.click(".submit")
    rater.wait("document.querySelector('.missing').textContent.startsWith('Not saved yet')")
    assert studio.judgements(study) == []
    rater.page.unroute("**/answer")
    rater.page.on(
        "request", lambda request: "/answer" in request.url and keys.append(request.headers["idempotency-key"])
    )
    rater.page.reload()
    rater.see(".task")
    rater.passed(before)
    (row,) = studio.judgements(study)
    assert set(keys) == {row.key}


def test_when_the_session_has_ended_the_link_opens_it_again_and_the_answer_is_sent(studio, tab):
    study = studio.pairwise(presentation="side_by_side")
    link = studio.links(study)[0]
    rater = tab().begin(link)
    rater.watch()
    rater.choose()
    rater.page.context.clear_cookies()
    rater.page.click(".submit")
    rater.wait("document.querySelector('h1')?.textContent === 'Open your invitation'")
    assert studio.judgements(study) == []
    rater.page.goto(link)
    rater.see(".task")
    assert rater.number.startswith("2 ")
    assert len(studio.judgements(study)) == 1


def test_a_double_click_answers_one_task(studio, tab):
    study = studio.pairwise(presentation="side_by_side")
    rater = tab().begin(studio.links(study)[0])
    rater.watch()
    rater.choose()
    before = rater.task
    rater.page.evaluate("() => { const button = document.querySelector('.submit'); button.click(); button.click(); }")
    rater.passed(before)
    rater.page.keyboard.press("Enter")
    assert rater.number.startswith("2 ")
    assert len(studio.judgements(study)) == 1


def test_the_back_button_leads_out_and_forward_again_to_the_same_task(studio, tab):
    study = studio.pairwise(presentation="side_by_side")
    rater = tab()
    rater.page.goto(f"{studio.url}/avatar.glb/nothing")  # an entry in the history
    rater.begin(studio.links(study)[0])
    rater.judge()
    rater.page.check("[data-question=beat_matching] input[value='1']")
    before = rater.task
    rater.page.go_back()
    rater.page.go_forward()
    rater.see(".task")
    assert rater.task == before
    assert rater.page.is_checked("[data-question=beat_matching] input[value='1']")
    assert "#" not in rater.page.url
    rater.judge()
    assert len(studio.judgements(study)) == 2


def test_two_tabs_never_judge_twice(studio, tab):
    """The other tab is notified; if that fails, the studio refuses the second answer and the tab moves on."""
    study = studio.pairwise(presentation="side_by_side")
    first = tab().begin(studio.links(study)[0])
    second = RaterTab(first.page.context.new_page())
    second.page.goto(f"{studio.url}/rate?quality=low")
    second.see(".task")
    assert second.task == first.task
    first.page.bring_to_front()
    one = first.task
    first.judge(rating=2)
    second.page.bring_to_front()
    second.passed(one)
    assert second.task == first.task
    # now without notifications between the tabs
    second.page.evaluate("__studio.flow.channel.close()")
    second.watch()
    second.choose(rating=-1)
    two = second.task
    first.page.bring_to_front()
    first.judge(rating=2)
    second.page.bring_to_front()
    second.page.click(".submit")
    second.passed(two)
    rows = studio.judgements(study)
    assert [abs(row.overall_preference) for row in rows] == [2, 2]


def test_another_device_goes_on_where_the_first_one_was(studio, tab):
    study = studio.pairwise(presentation="side_by_side")
    phone = tab()
    phone.page.goto(studio.links(study, 3, is_open=True)[0])
    phone.see(".resume input")
    resume = phone.page.input_value(".resume input")
    phone.page.click(".agree")
    phone.see(".task")
    phone.judge()
    actions = tab()
    actions.page.goto(resume.replace("/rate#", "/rate?quality=low#"))
    actions.see(".task")
    assert actions.number.startswith("2 ")
    actions.judge()
    assert studio.raters(study) == 1
    assert len(studio.judgements(study)) == 2


def test_a_task_is_judged_with_keys_alone(studio, tab):
    study = studio.preference()
    rater = tab(1000, 640).begin(studio.links(study)[0])
    keys = rater.page.keyboard
    rater.page.evaluate("document.activeElement.blur()")
    keys.press("a")
    rater.wait("__studio.player.watched.every((times) => times > 0)", 120)
    keys.press(" ")
    rater.wait("__studio.player.playing.length === 0")
    for key in ("3", "b", "ArrowRight", "w"):
        keys.press(key)
    rater.wait("document.querySelector('.missing').textContent.includes('Best: 3. Worst: 4.')")
    before = rater.task
    keys.press("Enter")
    rater.passed(before)
    assert len(studio.judgements(study)) == 1


def test_no_clear_difference_is_an_answer_after_all_were_watched(studio, tab):
    study = studio.preference()
    rater = tab(1000, 640).begin(studio.links(study)[0])
    assert rater.page.is_disabled(".skip")
    rater.watch()
    before = rater.task
    rater.page.click(".skip")
    rater.passed(before)
    assert studio.judgements(study)[0].skipped == "no_difference"


# Notes, at each change, what hides a clip and how often it was played: a clip may be over before a busy machine asks.
CURTAIN = """(slot) => {
  const curtain = document.querySelector(`.cell[data-slot='${slot}'] .curtain`);
  window.curtain = [];
  const note = () => window.curtain.push([curtain.textContent, __studio.player.plays[slot]]);
  new MutationObserver(note).observe(curtain, { childList: true });
}"""


def test_one_after_the_other_shows_one_at_a_time_in_the_drawn_order(studio, tab):
    study = studio.pairwise(presentation="sequential", seconds=1.0)
    rater = tab().begin(studio.links(study)[0])
    first = rater.ask("__studio.flow.page.setting.next.task.first")
    rater.page.evaluate(CURTAIN, 1 - first)
    rater.page.click(".controls button.play")
    rater.wait("__studio.player.watched.every((times) => times === 1)", 120)
    hidden = "AB"[1 - first]
    assert rater.ask("curtain")[0] == [hidden, 0]
    assert list(dict.fromkeys(text for text, _ in rater.ask("curtain")))[:3] == [hidden, f"Next: {hidden}", ""]
    assert rater.ask("__studio.player.plays") == [1, 1]
    assert rater.ask("__studio.player.playing") == []


def test_every_pane_shows_a_still_before_play(studio, tab):
    """Of eight candidates, none of which has been played, each pane has the avatar in it."""
    study = studio.preference(candidates=8)
    rater = tab(1000, 640).begin(studio.links(study)[0])
    shares = """(() => {
      const canvas = document.querySelector("canvas.views");
      const flat = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
      flat.drawImage(canvas, 0, 0);
      const host = canvas.getBoundingClientRect();
      const scale = canvas.width / host.width;
      return [...document.querySelectorAll(".cell[data-slot]")].map((cell) => {
        const box = cell.getBoundingClientRect();
        const [x, y] = [(box.left - host.left) * scale, (box.top - host.top) * scale].map(Math.round);
        const { data } = flat.getImageData(x, y, Math.round(box.width * scale), Math.round(box.height * scale));
        return data.filter((value, k) => k % 4 === 3 && value > 250).length / (data.length / 4);
      });
    })()"""
    rater.wait(f"{shares}.every((share) => share > 0.01)", 60)
    assert len(rater.ask(shares)) == 8
    assert rater.ask("__studio.player.plays") == [0] * 8


def test_motion_is_locked_to_the_sound(studio, tab):
    """A display frame shows what is heard, plus at most the predicted delay until it is on screen."""
    study = studio.preference(candidates=2)
    rater = tab(300, 520).begin(studio.links(study)[0])
    rater.page.click(".controls button.play")
    rater.wait("__studio.player.position > 0")
    gaps = rater.page.evaluate("""async () => {
      const gaps = [];
      for (let k = 0; k < 12; k++) {
        await new Promise(requestAnimationFrame);
        const { position, shown, playing } = __studio.player;
        if (playing.length && position > 0) gaps.push(shown[0] - (position % 1));
      }
      return gaps;
    }""")
    folded = [(gap + 0.5) % 1 - 0.5 for gap in gaps]
    assert len(folded) > 5
    assert sorted(map(abs, folded))[len(folded) // 2] < 0.13
    assert rater.ask("__studio.player.plays")[0] >= 1


def test_a_rater_is_told_nothing_of_the_design(studio, tab):
    study = studio.pairwise(presentation="side_by_side")
    rater, told = tab(), []
    rater.page.on(
        "response", lambda answer: told.append(f"{answer.url} {answer.headers}") if "/api/" in answer.url else None
    )
    rater.begin(studio.links(study)[0])
    rater.judge()
    text = (
        " ".join(told) + rater.page.content() + rater.page.evaluate("JSON.stringify(__studio.flow.page.setting.next)")
    )
    for secret in (*canned.SYSTEMS, study, "candidate", "corrupted", "identical", ".motion"):
        assert secret not in text


def test_refusing_and_withdrawing_leave_nothing(studio, tab):
    study = studio.pairwise(presentation="side_by_side")
    link = studio.links(study, 2, is_open=True)[0]
    refusing = tab()
    refusing.page.goto(link)
    refusing.see(".disagree")
    refusing.page.click(".disagree")
    refusing.wait("document.querySelector('h1').textContent === 'Nothing was kept'")
    assert studio.raters(study) == 0
    leaving = tab().begin(link)
    leaving.judge()
    assert len(studio.judgements(study)) == 1
    leaving.page.click(".menu summary")
    leaving.page.click(".menu .withdraw")
    leaving.page.click("dialog [value=yes]")
    leaving.wait("document.querySelector('h1').textContent === 'Everything was deleted'")
    assert (studio.raters(study), studio.judgements(study)) == (0, [])


@pytest.mark.parametrize(
    ("path", "title"), [("/rate", "Open your invitation"), ("/rate#" + "x" * 43, "This did not work")]
)
def test_without_a_good_link_the_page_says_what_to_do(studio, tab, path, title):
    rater = tab()
    rater.page.goto(studio.url + path)
    rater.wait(f"document.querySelector('h1')?.textContent === {title!r}")


def test_a_page_speaks_the_language_of_the_study(studio, tab):
    """Texts that the owner's file lacks are in English."""
    words = studio.maker.media.parent / "words"
    words.mkdir(exist_ok=True)
    (words / "de.json").write_text('{"rate_agree": "Einverstanden, los geht es", "play_both": "Beide abspielen"}')
    study = studio.pairwise(presentation="side_by_side", language="de-AT")
    rater = tab()
    rater.page.goto(studio.links(study)[0])
    rater.see(".agree")
    assert rater.page.inner_text(".agree") == "Einverstanden, los geht es"
    assert rater.page.inner_text(".disagree") == "I do not agree"
    assert rater.page.get_attribute("html", "lang") == "de"
    rater.page.click(".agree")
    rater.see(".task")
    assert rater.page.inner_text(".controls .play") == "Beide abspielen"


def test_a_busy_studio_is_waited_for(studio, tab):
    study = studio.pairwise(presentation="side_by_side")
    rater, refused = tab(), []

    def refuse(route: Any) -> None:
        if len(refused) >= 2:
            return route.continue_()
        refused.append(1)
        problem = '{"code": "too_many_requests", "message": "slowly", "retry_after": 0.6}'
        return route.fulfill(status=429, content_type="application/json", body=problem)

    rater.page.route("**/clips/1", refuse)
    rater.begin(studio.links(study)[0])
    assert len(refused) == 2


@pytest.mark.parametrize(
    ("kind", "width", "height", "colours"),
    [
        ("pairwise", 360, 640, "light"),
        ("pairwise", 844, 390, "dark"),
        ("pairwise", 1280, 800, "light"),
        ("preference", 390, 844, "dark"),
        ("preference", 1280, 800, "light"),
    ],
)
def test_nothing_is_cut_off_or_pale_and_everything_has_a_name(studio, tab, kind, width, height, colours, tmp_path):
    study = studio.pairwise() if kind == "pairwise" else studio.preference()
    rater = tab(width, height, color_scheme=colours)
    rater.page.goto(studio.links(study)[0])
    rater.see(".agree")
    assert rater.ask(OUTSIDE) == rater.ask(PALE) == []
    rater.page.click(".agree")
    rater.see(".task")
    assert rater.ask(OUTSIDE) == rater.ask(PALE) == []
    assert rater.ask(NAMELESS) == []
    assert rater.ask("document.activeElement.tagName") == "H1"
    assert rater.ask("document.documentElement.scrollWidth <= innerWidth")
    rater.shot(tmp_path / f"{kind}-{width}.png")


def test_reduced_motion_repeats_nothing_by_itself(studio, tab):
    study = studio.pairwise(presentation="side_by_side")
    rater = tab(reduced_motion="reduce").begin(studio.links(study)[0])
    assert rater.page.get_attribute("[aria-label='Repeat']", "aria-pressed") == "false"
    rater.watch()
    rater.wait("__studio.player.playing.length === 0")
    assert rater.ask("__studio.player.plays") == [1, 1]
