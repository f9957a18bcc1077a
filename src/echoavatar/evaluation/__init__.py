"""What a bundle is worth: reconstruction, audio reliance, behaviour, alignment, latency.

May import `engine` and below.
"""
