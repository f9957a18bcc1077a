"""Sound: codec, streaming resampler, level control, files. May import `quantize`, `nn` and below."""
