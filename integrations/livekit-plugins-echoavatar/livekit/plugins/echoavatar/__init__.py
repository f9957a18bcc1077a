"""EchoAvatar for LiveKit agents: an avatar in the agent's process, or in a worker process."""

from livekit.agents import Plugin

from .avatar import AvatarSession, RemoteAvatarSession
from .film import Film
from .log import logger
from .performer import Performer
from .version import __version__
from .worker import AvatarWorker

__all__ = ["AvatarSession", "AvatarWorker", "Film", "Performer", "RemoteAvatarSession", "__version__"]


class _EchoAvatarPlugin(Plugin):
    def __init__(self) -> None:
        super().__init__(__name__, __version__, __package__ or "", logger)


Plugin.register_plugin(_EchoAvatarPlugin())
