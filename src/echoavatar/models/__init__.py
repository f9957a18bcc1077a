"""The trained models, each with its training: audio codec, quantiser, motion tokenizer, generator, face, fingers, warp.

May import `training`, `data`, `motion` and below. Inside: `tokens` and `quantize` serve the others; `generator` may use
`tokens`, `tokenizer` and `audio`; `face` and `warp` hear what the codec hears.
"""
