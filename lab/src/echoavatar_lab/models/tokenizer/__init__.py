"""Training of the motion tokenizer and of its decoder.

May import `quantize`, `data`, `training`, `progress` and `echoavatar`.
"""
