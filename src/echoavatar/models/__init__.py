"""The trained models, each with its training: audio codec, quantiser, motion tokenizer, generator, face, fingers.

May import `training`, `data`, `motion` and below. Inside: `tokens` and `quantize` serve the others; `generator` may use
`tokens`, `tokenizer` and `audio`; `face` hears what the codec hears.
"""
