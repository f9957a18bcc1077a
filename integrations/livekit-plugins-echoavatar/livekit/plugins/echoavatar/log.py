"""The plugin's logger, where LiveKit looks for it."""

import logging

logger = logging.getLogger("livekit.plugins.echoavatar")
