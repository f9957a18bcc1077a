"""The page shows another program's session."""

import asyncio
import threading

import pytest
from tests.agents.proxy.places import avatar_server, listening, proxied, tone

pytestmark = pytest.mark.browser


def test_the_newest_session_is_shown_and_moves(new_page):
    """A scripted voice speaks through the proxy; the page has no session of its own, and no sound."""
    begun, over = threading.Event(), threading.Event()

    async def script(part):
        while not over.is_set():
            await part.say(tone(4.0), item=f"item_{len(part.sent)}", pace=1.0, until=over.is_set)

    async def lead(address):
        async with proxied(script, address) as (url, _, _), listening(url) as client:
            await client.listen(lambda c: bool(c.of("echoavatar.animation_body.delta")), 60)
            begun.set()
            await client.listen(lambda _: over.is_set(), 300)

    with avatar_server() as place:
        leading = threading.Thread(target=lambda: asyncio.run(lead(place.address)), daemon=True)
        leading.start()
        try:
            assert begun.wait(60)
            driver = new_page(480, 360)
            driver.open(f"http://{place.address}/?quality=low&watch")
            driver.wait("__echo.shown && __echo.shown.state === 'speaking'")
            before = driver.ask("__echo.session.player.pose.root[1]")
            driver.wait(f"__echo.session.player.pose.root[1] !== {before}")
            assert len(place.manager.names) == 1
            assert driver.problems == []
        finally:
            over.set()
            leading.join(20)
