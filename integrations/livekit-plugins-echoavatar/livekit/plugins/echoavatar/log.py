"""The plugin's logger, in the place where LiveKit looks for it."""

import logging

logger = logging.getLogger("livekit.plugins.echoavatar")
