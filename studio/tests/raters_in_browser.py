"""A running studio, and raters who use its pages by clicks and keys, each in a tab of their own."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import uvicorn
from sqlalchemy import func, select
from studio.tests import canned
from tests.web.conftest import PageDriver

from echoavatar_studio.app import create_app
from echoavatar_studio.making import Maker
from echoavatar_studio.owner_actions import OwnerActions
from echoavatar_studio.tables import Judgement, Rater, Study, Task, Trial
from echoavatar_studio.wire_owner import Invite

PATIENCE_S = 120  # WebGL runs on the processor here, which may be busy
OUTSIDE = """[...document.querySelectorAll(
  "button, h1, h2, legend, .choice, footer, header, input, select, .cell"
)].filter((element) => {
  const box = element.getBoundingClientRect();
  return box.width && !element.closest(".table, .tabs, nav") && (box.left < -1 || box.right > innerWidth + 1);
}).map((element) => element.className || element.textContent)"""
NAMELESS = """[...document.querySelectorAll("button, input, select, textarea, summary, a")].filter((element) =>
  element.getBoundingClientRect().width && !(element.getAttribute("aria-label") || element.textContent.trim()
  || element.labels?.length || element.closest("label"))).map((element) => element.outerHTML)"""
# WCAG 2.2, 1.4.3: 4.5 times the luminance of what the text lies on, or the other way round; 3 times where it is large
PALE = """(() => {
  const parts = (colour) => colour.match(/[0-9.]+/g).map(Number);
  const light = ([r, g, b]) => [r, g, b].map((v) => v / 255)
    .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
    .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  const under = (element) => {
    for (let at = element; at; at = at.parentElement) {
      const { backgroundColor, backgroundImage } = getComputedStyle(at);
      if (backgroundImage !== "none") return null;
      const colour = parts(backgroundColor);
      if (colour[3] === undefined || colour[3] > 0.99) return colour;
    }
    return [255, 255, 255];
  };
  const texts = [...document.body.querySelectorAll("*")].filter((element) =>
    [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim())
    && element.getBoundingClientRect().width > 1 && element.checkVisibility() && !element.closest(":disabled"));
  const found = texts.map((element) => {
    const style = getComputedStyle(element), ground = under(element);
    if (!ground) return null;
    const ink = parts(element instanceof SVGElement ? style.fill : style.color);
    const [one, other] = [light(ink), light(ground)].sort((a, b) => b - a);
    const size = parseFloat(style.fontSize), isLarge = size >= 24 || (size >= 18.66 && style.fontWeight >= 700);
    const ratio = (one + 0.05) / (other + 0.05);
    return ratio < (isLarge ? 3 : 4.5) ? `${element.textContent.trim().slice(0, 30)}: ${ratio.toFixed(2)}` : null;
  });
  if (texts.length < 3) throw new Error("no text was looked at");
  return found.filter((line) => line !== null);
})()"""


class Studio:
    """A studio on a free port of this machine, in a thread of this process."""

    def __init__(self, maker: Maker, library: Path) -> None:
        self.maker, self.library, self.url = maker, library, ""

    @contextlib.contextmanager
    def serving(self) -> Iterator["Studio"]:
        app = create_app(self.maker, library=self.library, rates=canned.EASY)
        server = uvicorn.Server(uvicorn.Config(app, port=0, log_level="warning", lifespan="off", ws="none"))
        thread = threading.Thread(target=server.run, daemon=True)
        thread.start()
        while not server.started:
            assert thread.is_alive()
            time.sleep(0.05)
        self.url = f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
        try:
            yield self
        finally:
            server.should_exit = True
            thread.join(20)
            self.maker.store.close()

    def pairwise(self, **changes: object) -> str:
        few = {"raters": 4, "tasks_per_rater": 3, "checks": {"identical": 1, "corrupted": 0}}
        return canned.make_pairwise(self.maker, self.library, **(few | changes))

    def preference(self, **changes: object) -> str:
        few = {"tasks_per_rater": 2, "checks": {"identical": 0, "corrupted": 0}, "candidates": 8}
        return canned.make_preference(self.maker, prompts=2, **(few | changes))

    def links(self, study: str, count: int = 1, *, is_open: bool = False) -> list[str]:
        made = OwnerActions(self.maker, "test").invite(
            study, Invite(count=count, is_open=is_open), page=f"{self.url}/rate?quality=low"
        )
        return [link.url for link in made.links]

    def judgements(self, study: str) -> list[Judgement]:
        """All answers, including training and checks, in the order in which they were saved."""
        with self.maker.store.read() as session:
            wanted = (
                select(Judgement)
                .join(Task, Judgement.task_id == Task.id)
                .join(Trial, Task.trial_id == Trial.id)
                .join(Study, Trial.study_id == Study.id)
                .where(Study.public == study)
                .order_by(Judgement.id)
            )
            return list(session.scalars(wanted).all())

    def raters(self, study: str) -> int:
        with self.maker.store.read() as session:
            wanted = select(func.count(Rater.id)).join(Study, Rater.study_id == Study.id).where(Study.public == study)
            return session.scalar(wanted) or 0


class RaterTab(PageDriver):
    """One tab of a rater."""

    def begin(self, link: str) -> "RaterTab":
        """Go from the link to the first task."""
        self.page.goto(link)
        self.see(".agree")
        self.page.click(".agree")
        self.see(".task")
        return self

    def see(self, selector: str, seconds: float = PATIENCE_S) -> None:
        self.wait(f"!!document.querySelector({selector!r})", seconds)

    @property
    def number(self) -> str:
        return str(self.page.inner_text(".bar .number"))

    @property
    def task(self) -> str:
        return str(self.page.evaluate("__studio.flow.page.draft.task"))

    @property
    def is_finished(self) -> bool:
        return bool(self.page.evaluate("document.querySelector('h1')?.textContent.startsWith('Thank you')"))

    def watch(self) -> None:
        """Play all clips to their end."""
        all_at_once = self.page.query_selector(".controls .all")
        (all_at_once or self.page.query_selector(".controls button.play")).click()
        self.wait("__studio.player.watched.every((times) => times > 0)", PATIENCE_S)

    def choose(self, rating: int = 1, best: int = 2, worst: int = 5) -> None:
        """Give every question the same answer, or mark two candidates."""
        for box in self.page.query_selector_all(f".question input[value='{rating}']"):
            box.check()
        for slot, which in ((best, "best"), (worst, "worst")):
            button = self.page.query_selector(f".cell[data-slot='{slot}'] .mark.{which}")
            if button and button.get_attribute("aria-pressed") == "false":
                button.evaluate("(it) => it.click()")  # on a phone's carousel it may be off screen
        self.wait("!document.querySelector('.submit').disabled", PATIENCE_S)

    def submit(self) -> None:
        """Send the answer and wait for the next page."""
        before = self.task
        self.page.click(".submit")
        self.passed(before)

    def passed(self, task: str) -> None:
        self.wait(
            f"document.querySelector('h1')?.textContent.startsWith('Thank you') "
            f"|| (__studio.flow.page !== null && __studio.flow.page.draft.task !== '{task}')",
            PATIENCE_S,
        )

    def judge(self, **choices: int) -> None:
        self.watch()
        self.choose(**choices)
        self.submit()


NewTab = Callable[..., Any]


def new_tab(browser: Any, width: int = 420, height: int = 560, **options: Any) -> RaterTab:
    """Open a tab in a browser context of its own."""
    context = browser.new_context(viewport={"width": width, "height": height}, **options)
    return RaterTab(context.new_page())
