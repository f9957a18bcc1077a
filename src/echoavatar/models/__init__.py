"""The trained models, as they run: audio codec, quantiser, motion tokenizer, generator, face, fingers.

May import `motion`, `nn` and below. Inside: `tokens` and `quantize` serve the others; `generator` may use `tokens`,
`tokenizer` and `audio`; `face` hears what the codec hears.
"""
