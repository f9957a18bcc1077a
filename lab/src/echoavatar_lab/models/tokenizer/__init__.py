"""The motion tokenizer in torch, its training and that of its decoder.

May import `quantize`, `codebook_training`, `data`, `training`, `nn`, `checkpoint`, `progress` and `echoavatar`.
"""
