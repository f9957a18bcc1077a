"""The web application of the studio."""

from pathlib import Path

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.routing import BaseRoute

from .http import Gate, nothing_here
from .limits import Rates
from .making import Maker
from .owner_routes import owner_routes
from .page import page_routes
from .rater_routes import rater_routes


def create_app(
    maker: Maker,
    *,
    library: Path | None = None,
    rates: Rates | None = None,
    origins: tuple[str, ...] = (),
) -> Starlette:
    """An ASGI application over a maker's store and folder of clips.

    `library` is where studies that are set up in the page may take models, clips and sounds from; `origins` are
    addresses of pages, besides its own, that may change something (a proxy that does not pass the Host header on).
    """
    gate = Gate(maker.store, rates=rates, origins=origins)
    routes: list[BaseRoute] = [
        *rater_routes(gate, maker.media),
        *owner_routes(gate, maker, library or maker.media.parent / "library"),
        *page_routes(words=maker.media.parent / "words"),
    ]
    app = Starlette(routes=routes, exception_handlers={HTTPException: nothing_here})
    app.state.maker = maker
    return app
