"""`python -m livekit.plugins.echoavatar` runs the worker."""

from .worker import main

main()
