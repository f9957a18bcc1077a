"""Measure the live page in headless Chromium with software GL: bytes on the wire, first picture, pictures a second.

    python scripts/measure_page.py                   # starts a server of its own; about two minutes
    python scripts/measure_page.py --url http://127.0.0.1:8765/ --gl gl-egl

Without --gl, Chromium itself chooses: on a machine without a graphics card WebGL runs in SwiftShader, and the rest of
the page is put together without GL. `--gl swiftshader` has all of it go through SwiftShader, which costs twice as much.
Needs the extras `serve` and `browser`, and a system Chromium. Prints a table for docs/results/page.md.
"""

import argparse
import os
import shutil
import statistics
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from try_avatar import served

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SIZE = {"width": 1280, "height": 720}
SECONDS = 12  # of speech, over which pictures and bytes are counted
WAIT_S = 120.0
SETTLED_S = 4.0  # after which a started browser has opened its own pages
# Records when the first picture with the avatar was drawn. Pages forbid `eval`, so this runs before their own scripts.
FIRST = """
(() => {
  const look = () => {
    const ready = window.__echo && __echo.avatar.driver && __echo.shown;
    if (ready) requestAnimationFrame(() => (window.__first = performance.now()));
    else requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
})();
"""

COLUMNS = (
    "quality", "bytes, page", "bytes, avatar", "first picture, s", "second visit, s", "pictures a second",
    "resolution, a side", "processor, ms per picture", "sound, kB/s", "motion, kB/s", "all, kB/s",
)  # fmt: skip
SCALE = "__echo.viewport.canvas.width / innerWidth"  # along each side
DRAWN = "__echo.viewport.renderer.info.render.frame"


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", help="a running server (default: start one)")
    parser.add_argument("--gl", default="", choices=("swiftshader", "gl-egl"), help="GL to use for all")
    parser.add_argument("--quality", nargs="*", default=["", "low"], help="values of ?quality=, '' is the page's own")
    parser.add_argument("--tries", type=int, default=3, help="visits over which the first picture is the median")
    args = parser.parse_args()
    from playwright.sync_api import sync_playwright

    own = nullcontext(args.url) if args.url else served("serve", "--port", "0")
    with own as url, sync_playwright() as driver:
        print(f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|")
        for quality in args.quality:
            print(row(driver, args, f"{url}?quality={quality}" if quality else url, quality or "auto"), flush=True)


def row(driver: Any, args: argparse.Namespace, url: str, name: str) -> str:
    """One quality's line of the table."""
    visits = [visit(driver, args.gl, url, plays=number == 0) for number in range(max(1, args.tries))]
    first, again = (statistics.median(seen[key] for seen in visits) for key in ("first", "again"))
    seen = visits[0]
    return (
        f"| {name} | {seen['page']:,.0f} | {seen['avatar']:,.0f} | {first:.1f} | {again:.1f} | {seen['fps']:.1f} "
        f"| {seen['scale']:.0%} | {seen['cost']:.0f} | {seen['sound']:.1f} | {seen['motion']:.1f} | {seen['all']:.1f} |"
    )


def visit(driver: Any, gl: str, url: str, *, plays: bool) -> dict[str, float]:
    """Open the page with an empty cache, open it again, and let it speak."""
    flags = ["--no-sandbox"]
    if gl:
        flags += ["--use-gl=angle", f"--use-angle={gl}", "--ignore-gpu-blocklist"]
    if gl == "swiftshader":
        flags.append("--enable-unsafe-swiftshader")
    browser = driver.chromium.launch(executable_path=CHROMIUM, args=flags)
    try:
        context = browser.new_context(viewport=SIZE)
        context.add_init_script(FIRST)
        page = context.new_page()
        wire = Wire(context.new_cdp_session(page))
        time.sleep(SETTLED_S)
        seen = {"first": open_page(page, url)}
        time.sleep(1)
        avatar = sum(size for address, size in wire.files.items() if "avatar" in address)
        seen |= {"avatar": avatar, "page": sum(wire.files.values()) - avatar}
        seen["again"] = open_page(page, url)
        if plays:
            page.locator("#begin").dispatch_event("click")
            wait(page, "__echo.shown.state === 'speaking'")
            wire.streams.clear()
            begun, rates, scales, pictures, spent = time.monotonic(), [], [], page.evaluate(DRAWN), browser_seconds()
            while time.monotonic() - begun < SECONDS:
                time.sleep(1)
                rates.append(page.evaluate("__echo.metrics.fps"))
                scales.append(page.evaluate(SCALE))
            took = 1000 * (time.monotonic() - begun)
            seen["cost"] = 1000 * (browser_seconds() - spent) / max(1, page.evaluate(DRAWN) - pictures)
            seen["scale"] = statistics.mean(scales[2:])
            seen |= {"fps": statistics.mean(rates[2:]), "all": sum(wire.streams.values()) / took}
            seen |= {kind: wire.streams.get(kind, 0) / took for kind in ("motion", "sound")}
        return seen
    finally:
        browser.close()


def browser_seconds() -> float:
    """Processor time of all processes that this one started and of theirs, but the server; Linux alone, else 0.

    Seconds on a clock tell little where a machine is shared; these hardly depend on what else runs.
    """
    parents, names, spent = {}, {}, {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            head, _, rest = entry.read_text().rpartition(")")
        except OSError:  # it has ended
            continue
        fields = rest.split()
        pid = int(entry.parent.name)
        parents[pid], names[pid] = int(fields[1]), head.partition("(")[2]
        spent[pid] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def is_ours(pid: int) -> bool:
        return pid in parents and (parents[pid] == os.getpid() or is_ours(parents[pid]))

    return sum(spent[pid] for pid in spent if names[pid].startswith("chrom") and is_ours(pid))


class Wire:
    """Counts what one tab receives, as sent: packed, with headers."""

    def __init__(self, devtools: Any) -> None:
        self.files: dict[str, float] = {}
        self.streams: dict[str, float] = {}  # bytes of the WebSocket's messages by kind
        self._addresses: dict[str, str] = {}
        devtools.on("Network.requestWillBeSent", self._asked)
        devtools.on("Network.loadingFinished", self._came)
        devtools.on("Network.webSocketFrameReceived", self._streamed)
        devtools.send("Network.enable")

    def _asked(self, event: dict[str, Any]) -> None:
        self._addresses[event["requestId"]] = event["request"]["url"]

    def _came(self, event: dict[str, Any]) -> None:
        address = self._addresses.get(event["requestId"], "")
        if address.startswith("http"):
            self.files[address] = self.files.get(address, 0) + event["encodedDataLength"]

    def _streamed(self, event: dict[str, Any]) -> None:
        import base64

        data = base64.b64decode(event["response"]["payloadData"])
        head = data[:24]
        kind = "motion" if b"motion" in head else "sound" if b"audio" in head or b"opus" in head else "other"
        self.streams[kind] = self.streams.get(kind, 0) + len(data) + (4 if len(data) > 125 else 2)


def open_page(page: Any, url: str) -> float:
    """Seconds from the navigation to the first picture of the avatar."""
    page.goto(url, wait_until="commit", timeout=1000 * WAIT_S)
    wait(page, "!!window.__first")
    return float(page.evaluate("window.__first")) / 1000


def wait(page: Any, condition: str) -> None:
    """Poll until a condition is true."""
    end = time.monotonic() + WAIT_S
    while not page.evaluate(condition):
        if time.monotonic() > end:
            sys.exit(f"{condition} did not become true within {WAIT_S:.0f} s")
        time.sleep(0.05)


if __name__ == "__main__":
    main()
