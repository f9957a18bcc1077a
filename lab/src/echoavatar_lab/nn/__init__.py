"""Building blocks of torch: the streaming contract, causal attention, CUDA graphs. May import `echoavatar`."""
