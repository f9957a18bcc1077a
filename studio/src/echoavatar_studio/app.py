"""The web application of the studio."""

from pathlib import Path

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.routing import BaseRoute

from .http import Gate, Rates, nothing_here
from .making import Maker
from .owner_routes import owner_routes
from .page import page_routes
from .rater_routes import rater_routes


def create_app(
    maker: Maker, *, library: Path | None = None, rates: Rates | None = None, origins: tuple[str, ...] = ()
) -> Starlette:
    """The ASGI application over the store and the media folder of a maker.

    Studies that are set up in the page may take models, clips and sounds only from `library`. `origins` are further
    addresses whose pages may make changes, for a proxy that does not pass the Host header on.
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
