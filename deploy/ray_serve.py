"""The live server on several machines, as a Ray Serve deployment.

    pip install 'echoavatar[ray]'
    serve run deploy.ray_serve:build seats=3 most=8

Every replica is a whole server with its own engine. A session stays with its replica, because its WebSocket does. Ray
sends a new client to a replica with a free seat and starts more replicas as seats fill up; when all are taken, it
refuses the connection. When a replica dies, its clients reconnect. Another replica does not know their session, so they
start a new one there with the sound that was not played yet (`echoavatar.agents.client` and the page do this), while
they play what they have buffered.
"""

import os
from typing import Any

from pydantic import BaseModel, Field
from ray import serve
from starlette.types import ASGIApp


class Options(BaseModel):
    """What `serve run` may set; the token comes from $ECHOAVATAR_TOKEN."""

    model: str = Field("default", description="bundle name or folder")
    seats: int = Field(3, ge=1, description="sessions per replica")
    fewest: int = Field(1, ge=1, description="replicas kept")
    most: int = Field(4, ge=1, description="replicas at most")
    cpus: float = Field(2.0, gt=0, description="per replica")
    gpus: float = Field(0.0, ge=0, description="per replica")


@serve.ingress()
class Avatars:
    """One replica."""

    def __init__(self, model: str, seats: int) -> None:
        self._model, self._seats = model, seats
        self._manager: Any = None

    def __serve_build_asgi_app__(self) -> ASGIApp:  # noqa: N807
        """Called by Ray when the replica has started."""
        from echoavatar.engine import load
        from echoavatar.server import ServerSettings, create_app
        from echoavatar.wire.sockets import RequestChecks

        settings = ServerSettings(
            name=serve.get_replica_context().replica_id.unique_id,
            token=os.environ.get("ECHOAVATAR_TOKEN", ""),
            connections=self._seats + SPARE,
        )
        engine = load(self._model, seats=self._seats)
        engine.measure()
        app = create_app(engine, settings)
        self._manager = app.state.manager
        return RequestChecks(app, None if settings.token else ())

    def check_health(self) -> None:
        """Ray replaces a replica whose engine has failed."""
        if self._manager is not None and self._manager.failure is not None:
            raise RuntimeError("the engine has failed")


SPARE = 4  # requests beyond the seats: pages, health checks, refusals with a message


def build(options: Options) -> serve.Application:
    """The application for `serve run`."""
    return deployment(Avatars, options).bind(options.model, options.seats)


def deployment(replica: type, options: Options) -> serve.Deployment:
    """Maps seats to Ray's limits: a session is one long request."""
    return serve.deployment(
        replica,
        name="avatars",
        max_ongoing_requests=options.seats + SPARE,
        max_queued_requests=SPARE,
        autoscaling_config={
            "min_replicas": options.fewest,
            "max_replicas": options.most,
            "target_ongoing_requests": max(0.5, 0.7 * options.seats),
            "upscale_delay_s": 5,
            "downscale_delay_s": 300,
        },
        ray_actor_options={"num_cpus": options.cpus, "num_gpus": options.gpus},
        graceful_shutdown_timeout_s=20,
        health_check_period_s=2,
        health_check_timeout_s=10,
    )
