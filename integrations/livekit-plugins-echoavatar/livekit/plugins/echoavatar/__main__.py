"""`python -m livekit.plugins.echoavatar`: the worker."""

from .worker import main

main()
